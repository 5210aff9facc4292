"""The wire as documents that programs read: JSON Schema of the messages, AsyncAPI of senders and readers.

All of it is drawn from the tables of `cogradar.shared.protocol`. Never here: a fact that no table has.
"""
