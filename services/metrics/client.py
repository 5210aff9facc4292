"""Asking metrics a question from the command line: over Zenoh, or straight from a store file."""

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial

from cogradar.services.certs import own
from cogradar.services.errors import BadInput, NoMetrics, NoSuchRun
from cogradar.services.metrics.answers import Rows, answer
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.address import shown
from cogradar.shared.wire.queries import BadRequest, NoAnswer, ask
from cogradar.shared.wire.session import open_session

CONNECT_WITHIN_S = 3.0
CURE = (
    "; a run that was kept answers from its file: --store FILE; beside `cogradar run --keep` use the --connect that it"
    " prints"
)
ANSWER_WITHIN_S = 10.0  # on a busy machine it takes a while


def ask_service(endpoint: str, metric: str, parameters: dict[str, str]) -> Rows:
    """Rows of a metric from the metrics service behind a router. Raises BadInput, NoMetrics."""
    own.check(endpoint, own.ASKING)
    try:
        session = open_session(endpoint.split(","), CONNECT_WITHIN_S, check=lambda: None)
    except ConnectionError as error:
        raise NoMetrics(f"no metrics service: {error}{CURE}") from None
    try:
        rows: Rows = json.loads(ask(session, metric, parameters, timeout_s=ANSWER_WITHIN_S))
    except NoAnswer:
        raise NoMetrics(f"no metrics service answers at {endpoint}{CURE}") from None
    except BadRequest as error:
        raise BadInput(str(error)) from None
    finally:
        session.close()
    return rows


@contextmanager
def source(
    store: str | None, endpoint: str, instead: Callable[[], str | None] = lambda: None
) -> Iterator[Callable[[str, dict[str, str]], Rows]]:
    """What answers (metric, parameters) with rows: a store file, or without one the service behind a router.

    instead : if no service answers the first question, the store that is asked from then on; None: there is none
    """
    with ExitStack() as opened:
        file, cure, asked, has_answered = store or "", "", partial(ask_service, endpoint), False

        def rows(metric: str, parameters: dict[str, str]) -> Rows:
            nonlocal file, cure, asked, has_answered
            try:
                found = asked(metric, parameters)
            except NoMetrics:
                if has_answered or not (file := instead() or ""):  # one answer is never of two sources
                    raise
                cure = ": --store FILE names another store"
            except NoSuchRun as error:
                if not file:
                    raise
                raise NoSuchRun(f"{error}; asked was {shown(file)}{cure}") from None
            else:
                has_answered = True
                return found
            asked = partial(answer, opened.enter_context(closing(Store(Journal(file, read_only=True)))))
            return rows(metric, parameters)

        if store is not None:
            asked = partial(answer, opened.enter_context(closing(Store(Journal(store, read_only=True)))))
        yield rows


def open_store(file: str) -> Store:
    """A store file with all its scores, to be read only. Raises BadInput if there is none."""
    with ExitStack() as opened:
        store = opened.enter_context(closing(Store(Journal(file, read_only=True))))
        store.derive()
        opened.pop_all()
    return store
