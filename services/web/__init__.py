"""Runs over HTTP, for people and pages: questions, events dwell by dwell, the page, and what can be asked, as OpenAPI.

Never here: a number that rows have (`cogradar.services.metrics`), or anything that a run would wait for.
"""
