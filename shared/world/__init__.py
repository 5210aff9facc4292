"""What nature decides: the targets, the disturbance, the scene that echoes.

For the emulator, scoring and checks; nothing of the radar (tracking, planning, power) ever imports it.
"""
