"""One run in one file: as a table with a row per thing and dwell, or whole, dwell by dwell, for viewers of recordings.

Never here: pictures (`cogradar.services.analysis.drawing`), and formats of other systems for tracks that are live.
"""
