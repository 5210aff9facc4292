"""A run's dwells as scores: which track follows which target, what is computed of each dwell, sums over blocks of them.

Never here: where scores are kept, or which client asks for them.
"""
