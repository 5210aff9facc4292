"""The durable leader of every run: it journals all messages, acknowledges dwells by checkpoints, recalls what is lost.

Never here: scores, and answers to people: a query must not delay a dwell (`cogradar.services.metrics`).
"""
