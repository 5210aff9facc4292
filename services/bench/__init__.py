"""How fast the parts and the whole are, what many targets would need, whether this installation computes as theory says.

Never here: anything that a run needs.
"""
