"""What nature decides: true targets, disturbance, echoes. Only the emulator, the checks and the scoring look.

Never here: anything that planners or the allocator could read.
"""
