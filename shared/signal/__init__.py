"""What a radar engineer knows by heart, in the direction of the signal: array, waveform, radar equation, receiver.

Never here: what nature draws (`cogradar.shared.world`), or what is concluded from a detection
(`cogradar.shared.tracking`).
"""
