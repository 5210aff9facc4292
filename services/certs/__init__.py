"""Access to the system: a private authority, a certificate for each process, and what each may do.

Never here: keys spelled out (`shared/protocol/topics.py` has them), or a connection.
"""
