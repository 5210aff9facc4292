"""The way to front ends in processes of their own.

Never here: what is measured, or what becomes of a front end that fails.
"""
