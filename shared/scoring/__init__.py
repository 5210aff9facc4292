"""How well a run went: tracks matched to targets, errors with intervals, bounds, finite-size theory.

Never here: anything that a decision uses.
"""
