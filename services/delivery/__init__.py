"""At-least-once delivery, the same for every role: resend until acknowledged, keep what is early, forget what is inactive.

A role's own state never lives here, nor does the transport.
"""
