"""Asking metrics a question from the command line: over Zenoh, or straight from a store file."""

import json

from services.metrics.answers import BadQuery, Rows, answer
from services.recorder.journal import Store
from services.recorder.schema import StoreError
from shared.wire.queries import BadRequest, NoAnswer, ask
from shared.wire.session import open_session

CONNECT_WITHIN_S = 3.0
ANSWER_WITHIN_S = 5.0


class NoMetrics(RuntimeError):
    """Nobody answers; the text says where it was asked."""


def ask_service(endpoint: str, metric: str, parameters: dict[str, str]) -> Rows:
    """Rows of a metric from the metrics service behind a router."""
    try:
        session = open_session(endpoint.split(","), CONNECT_WITHIN_S, check=lambda: None)
    except ConnectionError as error:
        raise NoMetrics(f"no metrics service: {error}") from None
    try:
        rows: Rows = json.loads(ask(session, metric, parameters, timeout_s=ANSWER_WITHIN_S))
    except NoAnswer:
        raise NoMetrics(f"no metrics service answers at {endpoint}") from None
    except BadRequest as error:
        raise BadQuery(str(error)) from None
    finally:
        session.close()
    return rows


def ask_store(file: str, metric: str, parameters: dict[str, str]) -> Rows:
    """Rows of a metric from a store file."""
    return answer(open_store(file), metric, parameters)


def open_store(file: str) -> Store:
    """A store file, to be read only. Raises BadQuery if there is none."""
    try:
        return Store(file, read_only=True)
    except StoreError as error:
        raise BadQuery(str(error)) from None
