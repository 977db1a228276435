# softcal without a desktop: the screens, the station's service, or one command.
#   docker build -t softcal .
#   docker run --rm -v "$PWD:/data" softcal batch lot-1
FROM python:3.12-slim-bookworm AS build
WORKDIR /src
COPY requirements.lock ./
RUN python -m venv /opt/softcal \
 && torch=$(sed -n 's/^\(torch==[0-9.]*\).*/\1/p' requirements.lock) \
 && /opt/softcal/bin/pip install --no-cache-dir --no-deps --extra-index-url https://download.pytorch.org/whl/cpu "$torch"
COPY requirements-image.lock ./
RUN /opt/softcal/bin/pip install --no-cache-dir --require-hashes --requirement requirements-image.lock
COPY pyproject.toml MANIFEST.in README.md LICENSE NOTICE ./
COPY app app
COPY core core
COPY db db
COPY station station
COPY firmware/softsensor firmware/softsensor
RUN /opt/softcal/bin/pip install --no-cache-dir --no-deps --no-build-isolation .

FROM python:3.12-slim-bookworm
COPY --from=build /opt/softcal /opt/softcal
# dialout: the group that may open serial ports on Debian.
RUN useradd --create-home --uid 10001 --groups dialout softcal && mkdir /data && chown softcal /data
USER 10001
WORKDIR /data
ENV PATH=/opt/softcal/bin:$PATH SOFTCAL_LOGS=/data/logs PYTHONUNBUFFERED=1
ENTRYPOINT ["softcal"]
CMD ["--help"]
