"""Tracks whose cells are steered: looks in any direction, measured directions and ranges, for the same filter.

Never here: the filter itself, or how bins are read.
"""
