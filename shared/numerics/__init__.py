"""Keyed random numbers and compiled kernels: how this program computes, whatever it computes.

Knows no radar; nothing here draws a random number that is not keyed or keeps a kernel of other sources.
"""
