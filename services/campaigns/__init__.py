"""Many runs of one scenario into one store: on the cores of this machine, or on services that are up.

Never here: how a single run is played (`services.runs`), or what the results show (`services.analysis`).
"""
