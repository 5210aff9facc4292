"""How well a run went: tracks matched to targets, alone and together, errors, intervals, bounds, finite-size theory.

Never here: anything that a decision uses.
"""
