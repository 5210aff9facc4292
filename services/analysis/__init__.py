"""What the runs of a store show: as arrays, as numbers with intervals, as tables, figures and files.

Never here: a terminal, or a run that is played. (One that was recorded may be fed into a core again.)
"""
