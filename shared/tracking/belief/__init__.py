"""The belief of one target: how probable looks are, weights of particles, their resampling, the published rejection.

Never here: whose detection is whose, or what a track remembers.
"""
