"""Scenario files of whole skies: traffic that is made up, or that was recorded; and places on the earth.

Never here: how a sky is played, and what is made of it.
"""
