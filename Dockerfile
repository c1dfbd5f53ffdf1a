# The demo without a display: docker build -t planview . && docker run --rm -v "$PWD/out:/data/out" planview
FROM python:3.12-slim
WORKDIR /planview
COPY requirements.lock tools/system_libraries.sh ./
RUN bash system_libraries.sh && rm -rf /var/lib/apt/lists/*
RUN pip install --no-cache-dir --require-hashes -r requirements.lock
COPY . .
RUN pip install --no-cache-dir --no-deps .
# Compiled kernels are kept in the folder of this user.
RUN useradd --create-home user && mkdir -p /data/out && chown -R user /data
USER user
WORKDIR /data
ENTRYPOINT ["planview"]
CMD ["demo"]
