# The workspace on a full ROS 2 Jazzy:
#     docker build -t diffbot .
#     docker run --rm -it --net=host diffbot
# No image has been built from this file. Its steps were run by hand in a chroot of Debian 12 with Python 3.11.
# Tried: both copies without what .dockerignore names, the lines of grep and pip (apt's numpy and scipy stay), colcon build,
# the user and /bags, and the entrypoint: as user 1001, recorder_node wrote a bag to /bags, and /ws was read-only.
# Not tried: the base image (ROS and colcon came from pip, with a setup.bash written for the trial), rosdep (the python3-*
# packages of package.xml were named to apt-get), the image's Python 3.12, and ros2 launch.
FROM ros:jazzy-ros-base

SHELL ["/bin/bash", "-o", "pipefail", "-c"]
WORKDIR /ws

# First what changes seldom: the dependencies, by package.xml and by what only pip has (docs/how-to/install-on-ros.md).
COPY package.xml constraints.txt src/diffbot/
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-pip \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src --dependency-types exec -y \
    && rm -rf /var/lib/apt/lists/*
# Of the pins only those of these packages: apt's numpy and scipy stay.
RUN grep -E '^(filterpy|mcap|platformdirs|rosbags|websockets)==' src/diffbot/constraints.txt > pip.txt \
    && pip install --no-cache-dir --break-system-packages --requirement pip.txt

COPY . src/diffbot/
RUN source /opt/ros/jazzy/setup.bash && colcon build --packages-select diffbot

# Nodes run, and write their bags, as a user without rights.
RUN useradd --create-home --uid 1001 robot && install --directory --owner=robot /bags
USER 1001
WORKDIR /bags
ENTRYPOINT ["/ws/src/diffbot/docker-entrypoint.sh"]
CMD ["ros2", "launch", "diffbot", "simulation.launch.py"]
