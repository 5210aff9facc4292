"""Which cells get how much power: max-min with its solver and a reference in cvxpy; most detections; few bright looks.

Never here: why a track asks for a bin.
"""
