"""How the power is split over the beams: the max-min program, its solver, and an independent reference.

Knows bins, weights and antennas; no tracks, no scans.
"""
