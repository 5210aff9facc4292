"""What the page asks of a run: its dwells, what does not change in it, courses of targets, beams, beliefs, processes.

Never here: what pages of rows say (`cogradar.services.metrics.answers`), or how requests come in.
"""
