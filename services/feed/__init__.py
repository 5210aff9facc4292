"""Tracks for other systems: formats turn pictures of the air into bytes, transports send these.

Never here: anything that a run waits for, coordinates (`cogradar.services.skies.place`), how a run is commanded.
"""
