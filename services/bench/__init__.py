"""How fast the parts and a whole dwell are, and whether an installation computes as it should.

Never here: anything that a run needs.
"""
