"""At-least-once delivery, as every role does it: resend until acknowledged, keep what is pending, forget inactive runs.

Never here: a role's own state, or the transport.
"""
