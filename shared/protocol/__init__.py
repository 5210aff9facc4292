"""Every message and every topic between the processes, and whether a valid message makes sense in its run.

Never here: how messages travel (`cogradar.shared.wire`), or what a role does with them.
"""
