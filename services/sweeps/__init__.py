"""Sweeps: the grid of scenarios that is played, and what comes out of it as a table and a figure; rules compared.

Never here: how runs are played (`services.campaigns`), or what one scenario's runs show (`services.analysis`).
"""
