"""Runs over HTTP, for people and pages: questions, events dwell by dwell, and what can be asked, as OpenAPI.

Never here: a number that `services.metrics` does not have, or anything that a run would wait for.
"""
