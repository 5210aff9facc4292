"""Where pictures come from: a run that goes on, heard live, or one that was recorded."""

import json
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

from pydantic import ValidationError

from cogradar.services.analysis.stored_run import Ask, StoredRun
from cogradar.services.certs import own
from cogradar.services.errors import BadInput, NoMetrics
from cogradar.services.feed.picture import PARTS, WITHOUT_PLOTS, Picture, Pictures, Wanted
from cogradar.services.metrics.client import ANSWER_WITHIN_S, CONNECT_WITHIN_S, CURE
from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, Scan, Waveform
from cogradar.shared.scenario.scenario import Scenario, SiteSection
from cogradar.shared.wire.codec import decode
from cogradar.shared.wire.queries import BadRequest, NoAnswer, ask
from cogradar.shared.wire.session import Session, open_session
from cogradar.shared.wire.zenoh_bus import Listener

TICK_S = 0.02  # without a message, after which what waits is looked at
PAUSE_S = 1.0  # before a question that had no answer is asked again
AGAIN_WITHIN_S = 3.0  # an answer about a run that has just begun: metrics may be busy with that, and is asked again
SILENT_S = 10.0  # of a run that goes on a checkpoint comes each second, and each fourth while others go on
KEPT = 2_000  # messages of runs that have begun, until metrics has said where the radar is

Check = Callable[[], None]  # raises Interrupted when the feed is to end


def site_from(text: str) -> SiteSection:
    """A site as it is written on a command line. Raises BadInput."""
    names = ("latitude_deg", "longitude_deg", "height_m", "boresight_deg")
    try:
        values = [float(part) for part in text.split(",")]
        return SiteSection.model_validate(dict(zip(names, values, strict=True)))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise BadInput(f"--site {text}: {first['loc'][0]}: {first['msg'].lower()}") from None
    except ValueError:
        raise BadInput(
            f"--site {text}: must be LATITUDE,LONGITUDE,HEIGHT,BEARING, in degrees and m, as 48.35,11.79,450,60"
        ) from None


def site_of(run: str, scenario: Scenario, given: SiteSection | None = None) -> SiteSection:
    """Where the radar of a run is: where it is `given`, or where its scenario says. Raises BadInput."""
    site = given or scenario.site
    if site is None:
        raise BadInput(
            f"run {run}: its scenario has no [site], so its tracks have no place on the earth: say it with"
            " --site LAT,LON,HEIGHT,BEARING, or begin a run with --set site.latitude_deg=..."
        )
    return site


def recorded(ask_metrics: Ask, run: str | None, speed: float, check: Check, wanted: Wanted) -> Iterator[Picture]:
    """The pictures of a run that was recorded, `speed` times as fast as it was; 0: without a pause. Raises BadInput."""
    stored = StoredRun(ask_metrics, run)
    site = site_of(stored.name, stored.scenario, wanted.site)
    pictures = Pictures(stored.name, stored.scenario, site, wanted)
    due_s = time.monotonic()
    parts = PARTS if wanted.plots else WITHOUT_PLOTS
    for _, payloads in stored.messages("plan", "waveform", "scan"):
        said = [decode(payload, parts) for payload in payloads]
        for picture in [one for message in said for one in pictures.take(message, due_s, time.time())]:
            while (left := due_s - time.monotonic()) > 0.0:
                check()
                time.sleep(min(left, 0.1))
            check()
            yield picture if picture.is_timed else picture._replace(utc_s=time.time())
            due_s += picture.period_s / speed if speed else 0.0


def live(
    endpoint: str, run: str | None, check: Check, notify: Callable[[str], None], wanted: Wanted
) -> Iterator[Picture | None]:
    """The pictures of a run as it goes on: of the newest, and then of those that begin after it; None: none just now.

    run : of this one alone, until it ends. Raises BadInput, NoMetrics.
    """
    own.check(endpoint, own.ASKING)
    followed = _Followed(partial(_connected, endpoint, wanted, check), run, check, notify, wanted)
    try:
        yield from followed.pictures()
    finally:
        followed.close()


class _Connection(NamedTuple):
    """What a run is heard by."""

    session: Session
    listener: Listener

    def close(self) -> None:
        """Hear no more."""
        self.listener.close()
        self.session.close()


def _connected(endpoint: str, wanted: Wanted, check: Check) -> _Connection:
    """Raises NoMetrics."""
    try:
        session = open_session(endpoint.split(","), CONNECT_WITHIN_S, check=check)
    except ConnectionError as error:
        raise NoMetrics(f"no metrics service: {error}{CURE}") from None
    kinds = (Checkpoint, Scan, Plan, Waveform)
    return _Connection(session, Listener(session, kinds, PARTS if wanted.plots else WITHOUT_PLOTS))


class _Followed:
    """The run that is followed, and those that it is not."""

    def __init__(
        self,
        connect: Callable[[], _Connection],
        run: str | None,
        check: Check,
        notify: Callable[[str], None],
        wanted: Wanted,
    ) -> None:
        self._connect, self._only, self._check, self._notify = connect, run, check, notify
        self._wanted = wanted
        self._link = connect()  # and listen, first: nothing is missed after metrics has answered
        self._heard_s = 0.0  # when the run that is followed was heard of, or was begun to be followed,
        self._is_silent = False  # ... and whether that was so long ago that it was said
        self._known: set[str] = set()  # runs that were looked at: they are followed, or not to be
        self._ended: set[str] = set()  # runs that were heard to end
        self._ask_s = 0.0  # when metrics may be asked again
        self._told = ""  # why it was not followed
        self._now: Pictures | None = None
        self._kept: deque[Message] = deque(maxlen=KEPT)  # of other runs, while metrics is asked about one of them

    def close(self) -> None:
        """Hear no more."""
        self._link.close()

    def pictures(self) -> Iterator[Picture | None]:
        """What the messages come to."""
        self._begin(self._row(self._only))
        last: Picture | None = None
        with ThreadPoolExecutor(1) as pool:
            asked: Future[dict[str, Any] | None] | None = None
            again: Future[str] | None = None
            while True:
                self._check()
                found, is_over = list[Picture](), False
                for message in self._link.listener.receive(TICK_S):
                    self._note(message)
                    if isinstance(message, Checkpoint):
                        is_over = is_over or self._is_end(message)
                        if asked is None and self._is_new(message):
                            asked = pool.submit(self._row, message.run, AGAIN_WITHIN_S)
                    else:
                        found += self._take(message)
                if asked is not None and asked.done():
                    found += self._answered(asked)
                    asked = None
                if again is None and self._now is not None and self._is_cut_off(self._now.run):
                    again = pool.submit(self._reconnect, self._now.run)
                if again is not None and again.done():  # another run may be followed by now
                    is_over = is_over or (self._now is not None and again.result() == self._now.run)
                    again = None
                if self._now is not None:
                    found += self._now.late(time.monotonic(), time.time())
                last = found[-1] if found else last
                yield from found or (None,)
                if is_over:
                    self._now = None
                    if last is not None:
                        yield last.without_tracks()
                    if self._only is not None:
                        return

    def _note(self, message: Message) -> None:
        """Note that the run that is followed was heard of."""
        if self._now is not None and message.run == self._now.run:
            self._heard_s, self._is_silent = time.monotonic(), False

    def _is_cut_off(self, run: str) -> bool:
        """Whether nothing was heard for long of the run that is followed: a link may be up, and carry nothing."""
        if time.monotonic() < self._heard_s + SILENT_S:
            return False
        self._heard_s = time.monotonic()
        if not self._is_silent:
            self._notify(f"nothing was heard of {run} for {SILENT_S:g} s; connecting anew")
        self._is_silent = True
        return True

    def _reconnect(self, run: str) -> str:
        """Hear by another connection; the run if it is over by now, as metrics says, or ""."""
        try:
            link = self._connect()
        except NoMetrics:
            return ""
        self._link, before = link, self._link
        before.close()
        try:
            row = self._row(run, AGAIN_WITHIN_S)
        except (BadInput, NoMetrics):
            return ""
        return "" if row is None or row["status"] == "running" else run

    def _take(self, message: Message) -> list[Picture]:
        if self._now is not None and message.run == self._now.run:
            return self._now.take(message, time.monotonic(), time.time())
        if self._only is None and message.run not in self._known:
            self._kept.append(message)
        return []

    def _is_end(self, message: Checkpoint) -> bool:
        """Whether the run that is followed is over."""
        if message.ended:
            self._known.add(message.run)
            self._ended.add(message.run)
        return message.ended and self._now is not None and message.run == self._now.run

    def _is_new(self, message: Checkpoint) -> bool:
        """Whether metrics is to be asked about a run that has begun: it is slow then, and other messages go on.

        While a run is followed, one that is heard of late is not newer.
        """
        if self._now is not None and message.k > 0:
            self._known.add(message.run)
        is_new = self._only is None and message.run not in self._known
        return is_new and time.monotonic() >= self._ask_s

    def _answered(self, asked: "Future[dict[str, Any] | None]") -> list[Picture]:
        """Follow the run that metrics was asked about; the pictures of what was heard of it meanwhile."""
        try:
            self._begin(asked.result())
        except (BadInput, NoMetrics) as error:
            self._ask_s = time.monotonic() + PAUSE_S
            if self._told != str(error):
                self._notify(str(error))
            self._told = str(error)
            return []
        kept, self._kept = self._kept, deque(maxlen=KEPT)
        return [picture for message in kept for picture in self._take(message)]

    def _begin(self, row: dict[str, Any] | None) -> None:
        """Follow a run, if there is one that goes on. Raises BadInput if it has no site."""
        if row is None or row["status"] != "running" or row["run"] in self._ended:
            if row is not None and self._only is not None:
                raise BadInput(f"run {row['run']}: is over; --store FILE replays a stored run")
            self._notify("no run goes on; waiting for one to begin")
            return
        self._known.add(row["run"])
        scenario = Scenario.model_validate(row["document"])
        site = site_of(row["run"], scenario, self._wanted.site)
        self._now, self._heard_s = Pictures(row["run"], scenario, site, self._wanted), time.monotonic()
        self._notify(f"following {row['run']}")

    def _row(self, run: str | None, within_s: float = ANSWER_WITHIN_S) -> dict[str, Any] | None:
        """The row of a run, of the newest if none is named; None: there is none yet. Raises BadInput, NoMetrics."""
        try:
            given = {} if run is None else {"run": run}
            (row,) = json.loads(ask(self._link.session, "one_run", given, within_s, self._check))
        except NoAnswer as error:
            raise NoMetrics(f"no metrics service: {error}{CURE}") from None
        except BadRequest as error:
            if run is None:
                return None
            raise BadInput(str(error)) from None
        found: dict[str, Any] = row
        return found
