"""Whose detection is whose, where tracks are so near to each other that they compete for them.

A scan says where each track was expected, as a Gaussian of direction and range. So every owner of a track finds the
same assignment from the scan alone. A detection belongs to one track, and a track has one detection. Tracks that
compete, directly or through others, are a cluster. Of all its assignments the most probable one holds (global nearest
neighbour; Blackman and Popoli, "Design and Analysis of Modern Tracking Systems").

Several echoes in one cell add: they are one detection, whose direction is between theirs or beyond. The track that it
is not assigned to is hidden there: that it has none is no miss. The direction is believed less by as much as the other
echo may have drawn it aside.

Symbols: p_ij probability that track i has its echo in the cell of detection j; sigma_nu standard deviation of a
direction.
"""
