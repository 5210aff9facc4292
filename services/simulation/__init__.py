"""Whole systems in simulated time: the real cores and the real journal under drawn faults, a schedule after the other.

Never here: a socket, a thread that a run would wait for, or a clock that is read.
"""
