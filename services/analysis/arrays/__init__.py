"""One run as NumPy arrays: dense ones by dwell and target, track or bin, and tables with a row per thing and dwell.

Never here: how they are drawn, or written to files.
"""
