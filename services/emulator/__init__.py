"""The radar's front end and the service around it: what transmits, receives, and publishes scans.

Here live the protocol of a front end, the simulated one and the recorded one, and the core that drives them.
Never here: what a scan means, how tracks are planned, how a run is stored.
"""
