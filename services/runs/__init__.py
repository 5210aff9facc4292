"""One run: played in this process, by processes started here, or on services that are up; cancelled; put to chaos.

Never here: what a role decides, or many runs at once (`cogradar.services.campaigns`).
"""
