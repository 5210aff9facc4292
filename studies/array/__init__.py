"""What the radar does in the world of an array, beyond what sweeps tell: docs/array.md.

Never here: how runs are played; that is the product's.
"""
