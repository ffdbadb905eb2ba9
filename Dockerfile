# The program in an image of its own:
#   docker build -t monogrid .
#   docker run --rm -v "$PWD:/data" --user "$(id -u)" monogrid run video.mp4
FROM rust:1.91-slim AS build
WORKDIR /src
COPY . .
RUN cargo build --release --locked --bin monogrid

FROM debian:trixie-slim
# what is not decoded by the program itself: HEVC, rtsp://, ...
RUN apt-get update && apt-get install --yes --no-install-recommends ffmpeg && rm -rf /var/lib/apt/lists/*
COPY --from=build /src/target/release/monogrid /usr/local/bin/monogrid
WORKDIR /data
ENTRYPOINT ["monogrid"]
