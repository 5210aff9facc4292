"""Other trackers on this radar's detections: an IMM-EKF, and an unscented Kalman filter of Stone Soup.

Here: what they make of the table of `cogradar export --what detections`, the skies, and scores of all trackers by one
rule. Never here: how this radar tracks.
"""
