"""Hours of everything at once: runs, faults, pages and questions, and whether what they take stays what it is.

Never here: what a dwell costs.
"""
