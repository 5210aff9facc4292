"""SAPIENT (BSI Flex 335 v2.0): the radar as a node of a fusion system, and what the system's tasks ask of it.

Never here: how a command reaches its run, which is in `cogradar.services.runs.command`.
"""
