# Untested: what `make setup` does, in a container. Build: docker build -t manywake .
# Then: docker run --rm -v "$PWD/runs:/manywake/runs" manywake .venv/bin/manywake train
FROM python:3.11-slim-bookworm
RUN apt-get update && apt-get install --yes --no-install-recommends make && rm -rf /var/lib/apt/lists/*
WORKDIR /manywake
COPY . .
RUN make setup
CMD ["make", "train"]
