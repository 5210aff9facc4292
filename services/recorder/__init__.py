"""The durable leader of every run: it journals all messages, acknowledges dwells by checkpoints, recalls what is lost.

Scores and answers to people never live here: a query must not delay a dwell (`services.metrics`).
"""
