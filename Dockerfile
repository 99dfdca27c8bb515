# The benchmark in a container: docker build -t samarl . && docker run --rm samarl
# Python 3.11, 3.12 or 3.13: docker build --build-arg PYTHON=3.13 ...
ARG PYTHON=3.11
FROM python:${PYTHON}-slim
WORKDIR /samarl
COPY . .
# Name an index with the CPU build of torch (--build-arg PIP_INDEX_URL=...) to save gigabytes.
ARG PIP_INDEX_URL
RUN pip install --no-cache-dir "torch==2.13.0" \
    && pip install --no-cache-dir -c constraints.txt ".[video]"
# Any other command: docker run --rm samarl samarl-evaluate agent=samarl scenario.robots=5
WORKDIR /work
CMD ["samarl-bench"]
