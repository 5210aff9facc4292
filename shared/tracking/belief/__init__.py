"""The belief of one target: how probable looks are; particles, their rejection and recovery; Gaussians that turn.

Never here: whose detection is whose.
"""
