# The demo without a display: docker build -t planview . && docker run --rm -v "$PWD/out:/work/out" planview
FROM python:3.12-slim
WORKDIR /planview
COPY requirements.lock tools/system_libraries.sh ./
RUN bash system_libraries.sh && rm -rf /var/lib/apt/lists/*
RUN pip install --no-cache-dir --require-hashes -r requirements.lock
COPY . .
RUN pip install --no-cache-dir --no-deps .
# Compiled kernels are kept in the folder of this user.
RUN useradd --create-home user && mkdir -p /work/out && chown -R user /work
USER user
WORKDIR /work
ENTRYPOINT ["planview"]
CMD ["demo"]
