"""A feed: tracks in the words of another system. `cogradar feed --to FILE.py:Lines --out -` sends them."""

from collections.abc import Sequence

from cogradar.plugins import Format, Output, Picture


class Lines(Format):
    """A line of text for each track: seconds since 1970, number, latitude, longitude, m/s, degrees from north."""

    def encode(self, picture: Picture) -> Sequence[Output]:
        """What is to be sent of a dwell: all tracks, so that a display that joins late has them at once.

        picture : tracks, time and site; `Picture.tracks` is empty once the run, or the feed, has ended
        returns : outputs in bytes, each a datagram, or part of a stream
        """
        return [
            Output(
                f"{picture.utc_s:.3f} {track.number} {track.latitude:.6f} {track.longitude:.6f}"
                f" {track.speed:.1f} {track.course_deg:.1f}\n".encode()
            )
            for track in picture.tracks
        ]
