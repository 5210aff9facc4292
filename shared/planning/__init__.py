"""Which bin to look at next: POMCP for any problem, the radar's problem, its exact value, and the rules that choose.

Never here: how a belief comes about (`cogradar.shared.tracking`), or how power is split (`cogradar.shared.power`).
"""
