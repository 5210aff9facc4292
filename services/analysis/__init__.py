"""What the runs of a store show: as arrays, as numbers with intervals, as tables and figures.

Never here: a terminal, or a run that is played.
"""
