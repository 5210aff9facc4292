"""The page's files, and the library that draws its charts, out of the installed packages: nothing from another host."""

import gzip
import hashlib
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response

from cogradar.services.web.parameters import asked, checked
from cogradar.services.web.problem_documents import missing
from cogradar.services.web.run_answers import is_known

PAGE = Path(__file__).parent / "page"
INDEX = "index.html"
CHARTS = "plotly.min.js"
KEPT = 64  # files, compressed; about 2 MB
MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".woff2": "font/woff2",
}
POLICY = (
    "default-src 'none'; script-src 'self'; connect-src 'self'; img-src 'self' data: blob:; font-src 'self';"
    " style-src 'self' 'unsafe-inline';"  # the charts set styles
    " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Cache-Control": "no-cache",  # a browser that has it asks whether it is still the same
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Vary": "Accept-Encoding",
    "X-Content-Type-Options": "nosniff",
}


def page(request: Request) -> Response:
    """The page: it takes its links' parameters itself."""
    return _answer(request, INDEX)


def file(request: Request) -> Response:
    """One of the page's files."""
    asked(request, ())
    return _answer(request, checked("name", request.path_params["name"]))


def _answer(request: Request, name: str) -> Response:
    path = _path(name)
    if path is None:
        raise missing(f"{name!r}: the page has no such file")
    packed, tag = _packed(path, path.stat().st_mtime_ns)
    headers = HEADERS | {"ETag": tag}
    if is_known(request, tag):
        return Response(status_code=304, headers=headers)
    if "gzip" in request.headers.get("accept-encoding", ""):
        return Response(packed, headers=headers | {"Content-Encoding": "gzip"}, media_type=MEDIA_TYPES[path.suffix])
    return Response(gzip.decompress(packed), headers=headers, media_type=MEDIA_TYPES[path.suffix])


def _path(name: str) -> Path | None:
    """Where a file of this name is; None if there is none."""
    if name == CHARTS:
        library = find_spec("plotly")  # which is not imported: nothing of it runs here
        folders = (library and library.submodule_search_locations) or []
        return next((Path(folder) / "package_data" / CHARTS for folder in folders), None)
    files = {path.name: path for path in PAGE.iterdir() if path.suffix in MEDIA_TYPES}
    return files.get(name)


@lru_cache(maxsize=KEPT)
def _packed(path: Path, changed_ns: int) -> tuple[bytes, str]:
    """A file compressed, and its tag. `changed_ns` is when it was changed: another date, another entry."""
    del changed_ns
    content = path.read_bytes()
    return gzip.compress(content, mtime=0), f'"{hashlib.sha256(content).hexdigest()[:32]}"'
