"""What a map shows beside the radar, read from packages of data that may be installed.

Never here: anything of a run, and any address on the net.
"""
