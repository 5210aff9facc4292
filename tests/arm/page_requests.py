"""What the page asks of a stored run, answered by this machine: `python -m tests.arm.page_requests STORE RUN`."""

import json
import sys
from typing import Any

import httpx

from cogradar.services.metrics.core import MetricsCore
from cogradar.services.web.address import listen, url
from cogradar.services.web.server import Server
from cogradar.shared.protocol.events import Tick

OF_THE_PAGE = ("/", "/page/main.js", "/api/v1/openapi.json", "/api/v1/runs")
OF_A_RUN = (
    *("", "/radar", "/timeline", "/beampattern?dwell=6", "/course?target=1", "/particles?target=1&dwell=6"),
    *("/dwells?dwells=1:12", "/p_d", "/summary", "/picture", "/tracks"),
)


def main() -> None:
    """Print the answers by request, with nine digits of each number: scores are no part of a run, and not portable."""
    store, run = sys.argv[1:]
    core, listener = MetricsCore(store), listen("127.0.0.1:0")
    assert listener is not None
    core.handle(Tick(0.0))
    server = Server(core, listener)
    paths = [*OF_THE_PAGE, *(f"/api/v1/runs/{run}{of}" for of in OF_A_RUN)]
    with httpx.Client(base_url=url(listener), timeout=300.0) as client:
        answers = {path: _words(client.get(path).raise_for_status()) for path in paths}
    server.close()
    core.close()
    print(json.dumps(answers))


def _words(answer: httpx.Response) -> Any:
    if "json" not in answer.headers["content-type"]:
        return answer.text
    return json.loads(answer.text, parse_float=lambda number: f"{float(number):.9g}")


if __name__ == "__main__":
    main()
