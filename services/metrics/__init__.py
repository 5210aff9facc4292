"""What runs have come to: scores derived from the journal, and the answers to people's questions about them.

Nothing here is needed by a run, and nothing here writes to the journal (`services.recorder`).
"""
