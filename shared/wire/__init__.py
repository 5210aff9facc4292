"""Everything that carries messages: codec, the buses, the main loop, queries, the digest of a run.

Only this folder imports zenoh and msgpack.
What a message means, and what a role answers, is never decided here.
"""
