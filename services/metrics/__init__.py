"""What runs have come to: scores derived from the journal, and the answers to people's questions about them.

Never here: anything that a run needs, or that writes to the journal (`cogradar.services.recorder`).
"""
