# Image for the cockpit and for clusters.
#
#     docker build --tag vrcaps .
#     docker run --rm --volume "$PWD/runs:/work/runs" vrcaps demo
#     docker run --rm --publish 127.0.0.1:8080:8080 vrcaps cockpit --host 0.0.0.0
#
# EXTRAS selects the optional dependencies: `--build-arg EXTRAS=learn,scale`.

FROM rust:1.89-slim-bookworm AS build
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3 python3-venv \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY constraints.txt ./
RUN python3 -m venv /tools \
    && /tools/bin/pip install --no-cache-dir --constraint constraints.txt maturin
COPY pyproject.toml README.md LICENSE ./
COPY rust rust
COPY src src
RUN /tools/bin/maturin build --release --locked --out /wheels

FROM python:3.12-slim-bookworm
ARG EXTRAS=cockpit,env,lesions,organs,reports,scale,video
COPY --from=build /wheels /wheels
COPY constraints.txt /wheels/
RUN wheel=$(echo /wheels/*.whl) \
    && pip install --no-cache-dir --constraint /wheels/constraints.txt "$wheel[$EXTRAS]" \
    && rm -r /wheels \
    && useradd --create-home --uid 1000 vrcaps \
    && mkdir --parents /work/runs /cache \
    && chown --recursive vrcaps /work /cache
# Any user ID can write to the cache, as clusters run containers under IDs of their own.
RUN chmod 1777 /cache /work /work/runs
ENV VRCAPS_CACHE=/cache \
    MPLCONFIGDIR=/cache/matplotlib \
    PYTHONUNBUFFERED=1
USER vrcaps
WORKDIR /work
EXPOSE 8080
ENTRYPOINT ["vrcaps"]
CMD ["--help"]
