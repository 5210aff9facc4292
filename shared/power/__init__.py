"""The max-min power allocation: its closed form, its interior-point solver, and a reference with cvxpy.

Never here: why a track asks for a bin.
"""
