# ROS 2 Jazzy and everything that manip_sim can use: see docs/installation.md.
FROM ros:jazzy@sha256:c3706ef0a0aa45413c07803cf433602f543b22e45b4855f6fca955c2d8ecc4e8

ENV PIP_BREAK_SYSTEM_PACKAGES=1 \
    PIP_CONSTRAINT=/ws/locked.txt \
    ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
WORKDIR /ws
COPY . src/manip_sim
# What pip installs has the versions of requirements/, but for NumPy: ROS packages from apt were
# built with NumPy 1.
RUN src/manip_sim/.ci/constraints run numpy > locked.txt \
    && echo 'numpy==1.26.4' >> locked.txt
# rosdep installs what package.xml names; numba from pip is built for this Python. OpenGL is for
# cameras, viser and trimesh for the viewer.
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libgl1-mesa-dri python3-pip \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src --default-yes \
    && python3 -m pip install --no-cache-dir 'numba>=0.58,<1' 'numpy<2' trimesh 'viser>=1.1,<2' \
    && rm -rf /var/lib/apt/lists/*
RUN . /opt/ros/jazzy/setup.sh && colcon build && useradd --create-home manip_sim
# Nothing below needs more rights; logs and caches are in the user's home.
USER manip_sim
WORKDIR /home/manip_sim
# Laws of control, in the user's cache; on another kind of processor, the first node compiles again.
RUN . /ws/install/setup.sh \
    && python3 -m manip_sim.control.law.loading

ENTRYPOINT ["/bin/bash", "-c", "source /ws/install/setup.bash && exec \"$@\"", "manip_sim"]
CMD ["ros2", "run", "manip_sim", "sim_node"]
