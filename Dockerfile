# One image for every role. docs/howto/deploy.md says what is in it, how large that is and why.
ARG PYTHON=3.12
# TARGETARCH is BuildKit's own: to declare it here would empty it.
# Kernels are compiled in the build for a processor that any machine of the architecture is. They compute the same on all.
FROM python:${PYTHON}-slim-bookworm AS base-amd64
ENV NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES=""

FROM python:${PYTHON}-slim-bookworm AS base-arm64
ENV NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES=""

FROM base-${TARGETARCH:-amd64} AS base
# The standard library comes without bytecode, and a read-only container could never keep any.
RUN python -m compileall -q -x '/(test|idlelib|lib2to3|ensurepip)/' "$(python -c 'import os; print(os.path.dirname(os.__file__))')"

FROM base AS builder
WORKDIR /opt/cogradar
# uv takes seconds where pip takes minutes. Nothing is installed without a hash of the lock, uv itself included.
COPY requirements.lock ./
RUN sed -n '/^uv==/,/[^\\]$/p' requirements.lock > /tmp/uv.txt && pip install --quiet --require-hashes --requirement /tmp/uv.txt
COPY pyproject.toml README.md ./
COPY deploy/container/dependencies.py /tmp/
RUN --mount=type=cache,target=/root/.cache/uv \
    uv venv --quiet venv \
    && uv pip compile --quiet --native-tls --no-header --no-annotate --extra postgres --constraint requirements.lock pyproject.toml \
        --output-file /tmp/wanted.txt \
    && python /tmp/dependencies.py requirements.lock /tmp/wanted.txt > /tmp/dependencies.txt \
    && uv pip install --quiet --native-tls --python venv --link-mode copy --compile-bytecode --only-binary :all: \
        --require-hashes --requirement /tmp/dependencies.txt \
    && find venv -type d -name tests -prune -exec rm -rf {} + \
    && rm -f venv/lib/python*/site-packages/scs/_scs_mkl.*
COPY deploy/scenarios deploy/scenarios
COPY deploy/plugins deploy/plugins
COPY shared shared
COPY services services
COPY cogradar cogradar
RUN uv pip install --quiet --native-tls --python venv --verify-hashes --build-constraint requirements.lock --no-deps --editable . \
    && rm -rf *.egg-info requirements.lock README.md \
    && python -m compileall -q cogradar
RUN COGRADAR_CACHE_DIR=/opt/cogradar/kernels venv/bin/python -c "from cogradar.services.kernels import compile_all; compile_all(print)"

FROM base
RUN groupadd --gid 10001 cogradar \
    && useradd --uid 10001 --gid 10001 --no-create-home --home-dir /tmp --shell /usr/sbin/nologin cogradar \
    && install -d -o cogradar -g cogradar /data
COPY deploy/container/entrypoint.sh /usr/local/bin/entrypoint
COPY deploy/container/healthy.sh /usr/local/bin/healthy
COPY --from=builder /opt/cogradar /opt/cogradar
ENV PATH=/opt/cogradar/venv/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    COGRADAR_CACHE_DIR=/tmp/kernels
WORKDIR /data
USER 10001:10001
STOPSIGNAL SIGTERM
ENTRYPOINT ["entrypoint"]
CMD ["--help"]
