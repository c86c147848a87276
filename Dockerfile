# ROS 2 Jazzy and everything that manip_sim can use: see docs/installation.md.
FROM ros:jazzy

ENV PIP_BREAK_SYSTEM_PACKAGES=1 \
    ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
WORKDIR /ws
COPY . src/manip_sim
# rosdep installs what package.xml names. OpenGL is for cameras, viser and trimesh for the viewer;
# ROS packages from apt were built with NumPy 1.
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libgl1-mesa-dri python3-pip \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src --default-yes \
    && python3 -m pip install --no-cache-dir 'numpy<2' trimesh 'viser>=1.1,<2' \
    && rm -rf /var/lib/apt/lists/*
RUN . /opt/ros/jazzy/setup.sh && colcon build

ENTRYPOINT ["/bin/bash", "-c", "source /ws/install/setup.bash && exec \"$@\"", "manip_sim"]
CMD ["ros2", "run", "manip_sim", "sim_node"]
