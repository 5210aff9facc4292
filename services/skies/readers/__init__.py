"""Positions of aircraft as the field writes them: tables, JSON of receivers, ASTERIX, Parquet.

Never here: which positions are believed, and what flights become of them.
"""
