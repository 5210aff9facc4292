"""What a radar engineer knows by heart, in the direction of the signal: array, waveform, radar equation, receiver.

Functions of their arguments. No targets, no disturbance model, no tracks, no random numbers.
"""
