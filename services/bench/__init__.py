"""How fast the parts and the whole are, what many targets would need, whether an installation computes as it should.

Never here: anything that a run needs.
"""
