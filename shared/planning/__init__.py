"""Where to look next: a tree search for any problem, the radar's problem, and the rules for choosing a bin.

A decision is a function of the belief and a generator; nothing here is kept from dwell to dwell.
"""
