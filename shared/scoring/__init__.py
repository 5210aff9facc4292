"""How well it went, with the truth at hand: matching, errors and intervals, bounds, receiver at finite size.

For metrics, analysis and checks; no decision of the radar ever reads it.
"""
