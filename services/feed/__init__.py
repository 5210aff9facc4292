"""Tracks for other systems: formats turn pictures of the air into bytes, transports send these; it only listens.

Never here: anything that a run waits for, and coordinates (`cogradar.services.skies.place`).
"""
