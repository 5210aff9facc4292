"""The figures of a store, and how they look.

Never here: how what they show is worked out.
"""
