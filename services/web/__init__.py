"""What metrics shows over HTTP.

Never here: how an answer is computed (`services.metrics`), or anything that a run needs.
"""
