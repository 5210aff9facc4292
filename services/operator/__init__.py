"""The operator: begins one run after the other on services that are up.

Never here: how a single run is played, which is in `cogradar.services.runs`.
"""
