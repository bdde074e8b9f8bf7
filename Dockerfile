# The command line without a Python of your own. In the folder of a log:
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/data" fusion-sfdia monitor --healthy last-week.csv --data today.csv
FROM python:3.12-slim AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY fusion_sfdia fusion_sfdia
COPY models models
COPY benchmarks benchmarks
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.12-slim
COPY --from=build /wheels /wheels
RUN pip install --no-cache-dir /wheels/*.whl \
    && useradd --uid 1000 --create-home sfdia \
    && install --directory --owner sfdia /data
USER sfdia
WORKDIR /data
ENTRYPOINT ["fusion-sfdia"]
CMD ["--help"]
