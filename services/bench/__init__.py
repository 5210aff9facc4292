"""How fast the parts and the whole are; whether this installation computes what theory says.

Never here: anything that a run needs.
"""
