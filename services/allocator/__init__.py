"""The allocator role: a dwell's plans in, the next waveform out; in real time at the latest when it is due.

Never here: how power is allocated (`cogradar.shared.power`), what a track believes, or the truth.
"""
