"""Studies of the program: measurements and comparisons that the documents report, and that no installation needs.

A study imports the product or uses its commands; the product never imports a study. `make -C studies` lists them.
"""
