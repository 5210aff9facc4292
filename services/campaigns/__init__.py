"""Many runs into one store: on the cores of this machine, or on the workers of a cluster.

Never here: how a single run is played (`cogradar.services.runs`), or what the results show
(`cogradar.services.analysis`).
"""
