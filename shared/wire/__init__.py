"""Everything that carries messages: codec, the buses, the main loop, queries, the digest of a run.

Only this folder imports zenoh and msgpack. Never here: what a message means, or what a role answers.
"""
