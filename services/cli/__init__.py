"""The command line: commands, what they print, what the shell completes.

Never here: what a service or a program in Python needs. No other room knows typer or rich.
"""
