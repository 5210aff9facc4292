"""The SQLite file of a journal: its tables, its lock, its transactions, and the epoch of the recorder that leads it.

Never here: what the rows of a run mean.
"""
