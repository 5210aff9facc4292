"""A store: its tables, in an SQLite file or on a PostgreSQL server; its lock, its transactions, and its leader.

Never here: what the rows of a run mean.
"""
