"""Sweeps: the grid of scenarios that is played, and the tables and the figure of its results.

Never here: how runs are played (`cogradar.services.campaigns`), or what one scenario's runs show
(`cogradar.services.analysis`).
"""
