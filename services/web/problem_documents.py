"""What went wrong, as the documents of RFC 9457: never a traceback."""

import json
from collections.abc import Mapping
from http import HTTPStatus

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from cogradar.services.errors import BadInput, StoreFailed

MEDIA_TYPE = "application/problem+json"
API = "/api/v1"
NO_SUCH_ADDRESS = f"no such address; {API}/runs has all runs, {API}/openapi.json describes every address"


class Problem(Exception):
    """An answer that is a problem document."""

    def __init__(self, status: HTTPStatus, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.status, self.detail, self.headers = status, detail, headers

    def response(self) -> Response:
        """The document."""
        document = {"type": "about:blank", "title": self.status.phrase, "status": self.status, "detail": self.detail}
        return Response(json.dumps(document), self.status, self.headers, MEDIA_TYPE)


def bad(detail: str) -> Problem:
    """A parameter is not what it must be."""
    return Problem(HTTPStatus.BAD_REQUEST, detail)


def missing(detail: str) -> Problem:
    """There is no such thing."""
    return Problem(HTTPStatus.NOT_FOUND, detail)


async def of_error(_: Request, error: Exception) -> Response:
    """The document about any exception that a route raised; no thread is needed for it."""
    match error:
        case Problem():
            return error.response()
        case BadInput():  # the question is well formed: what it is about does not exist
            return missing(str(error)).response()
        case StoreFailed():
            return Problem(HTTPStatus.SERVICE_UNAVAILABLE, str(error), {"Retry-After": "1"}).response()
        case HTTPException():
            status = HTTPStatus(error.status_code)
            detail = NO_SUCH_ADDRESS if status is HTTPStatus.NOT_FOUND else status.description or status.phrase
            return Problem(status, detail, error.headers).response()
        case _:
            return Problem(HTTPStatus.INTERNAL_SERVER_ERROR, "a fault of the service; its log says more").response()
