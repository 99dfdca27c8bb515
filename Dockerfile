# The benchmark in a container: docker build -t samarl . && docker run --rm samarl
# To choose Python 3.11, 3.12 or 3.13: docker build --build-arg PYTHON=3.13 ...
ARG PYTHON=3.11
FROM python:${PYTHON}-slim
WORKDIR /samarl
COPY . .
# --build-arg PIP_INDEX_URL=... with an index that has the CPU build of torch saves gigabytes.
ARG PIP_INDEX_URL
RUN pip install --no-cache-dir "$(grep '^torch==' constraints.txt)" \
    && pip install --no-cache-dir -c constraints.txt ".[video]"
# To run another command: docker run --rm samarl samarl-evaluate agent=samarl scenario.robots=5
WORKDIR /work
CMD ["samarl-bench"]
