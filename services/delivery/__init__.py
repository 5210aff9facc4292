"""At-least-once delivery, as every role does it: resend until acknowledged, keep what is pending, forget inactive runs.

A role's own state never lives here, nor does the transport.
"""
