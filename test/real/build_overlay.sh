#!/bin/sh
# build_overlay.sh CLONES WORK [PACKAGE ...]
# Builds an overlay of ROS 2 Jazzy, WORK/install, on the wheels: docs/how-to/install-on-ros.md says what it needs.
# CLONES has a git clone of each repository below, in a folder of its name. With names of packages only those are built.
# PYTHON chooses the interpreter, JOBS (2) how many packages are built at once, FLAGS (-O2) how the compiler optimizes.
set -eu
here=$(realpath "$(dirname "$0")") clones=$(realpath "$1") work=$(realpath -m "$2")
shift 2
venv=$work/venv

wheels() {
    "${PYTHON:-python3}" -m venv "$venv"
    # The bare names, without "jazzy", are those of other distributions.
    for name in ament-cmake ament-cmake-gen-version-h ament-cmake-gmock ament-cmake-gtest ament-cmake-include-directories \
        ament-cmake-pytest ament-cmake-python ament-cmake-ros ament-cmake-vendor-package ament-package common-interfaces \
        gmock-vendor gtest-vendor pybind11-vendor python-cmake-module rcl-action rcl-lifecycle 'rclpy[fastrtps]' \
        rmw-implementation rosidl-core-generators rosidl-default-generators; do
        echo "ros-jazzy-$name"
    done >"$work/wheels.part"
    "$venv/bin/pip" install -q -r "$work/wheels.part" setuptools==79.0.1 empy==4.2.1 numpy lark \
        colcon-bash colcon-cmake colcon-library-path colcon-metadata colcon-output colcon-package-information \
        colcon-package-selection colcon-parallel-executor colcon-python-setup-py colcon-recursive-crawl colcon-ros
    # Their CMake files have paths of the machine that built them, and a library that they do not need.
    include=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
    numpy=$("$venv/bin/python" -c 'import numpy; print(numpy.get_include())')
    tinyxml2=$(echo "$venv"/lib/python3.*/site-packages/ros_fastrtps.libs/libtinyxml2-*.so*)
    find "$venv/share" -name '*.cmake' -exec sed -i \
        -e "s:/opt/python/[^;\"]*/numpy/_core/include:$numpy:g" -e "s:/opt/python/[^;\"]*/include/python3[.0-9]*:$include:g" \
        -e "s:/usr/lib64/libtinyxml2.so:$tinyxml2:g" -e 's:lttng-ust;::g' {} +
    mv "$work/wheels.part" "$work/wheels.txt"
}

take() { # owner/name commit [folder ...]
    repository=${1#*/} commit=$2
    shift 2
    git -C "$clones/$repository" archive -o "$work/part.tar" "$commit" -- "$@"
    mkdir -p "$sources/$repository"
    tar -x -f "$work/part.tar" -C "$sources/$repository"
}

sources() {
    sources=$work/src.part
    rm -rf "$sources"
    take ros2/eigen3_cmake_module b5d2b9b
    take ros2/console_bridge_vendor abb96a9
    take ros2/orocos_kdl_vendor 9feb028
    take ros2/tinyxml2_vendor 85acf25
    take ros2/yaml_cpp_vendor 867dd6b
    take ros/class_loader 8bad929
    take ros/pluginlib 743972e pluginlib
    take ros2/rcl_interfaces 003987e composition_interfaces statistics_msgs
    take ros-tooling/libstatistics_collector df4e058
    take ros2/rclcpp 985e320de rclcpp rclcpp_action rclcpp_components rclcpp_lifecycle
    take ros2/message_filters d3eecd6
    take ros2/geometry2 646342c6 tf2 tf2_eigen tf2_geometry_msgs tf2_msgs tf2_py tf2_ros tf2_ros_py
    take ros2/urdf a76814d urdf urdf_parser_plugin
    take ros/kdl_parser c6f0299 kdl_parser
    take ros/robot_state_publisher e0f77e6
    take ros/angles 54ad72b
    take ros/diagnostics 31372a2 diagnostic_updater
    take ros-geographic-info/geographic_info 2a0ae99 geographic_msgs
    take cra-ros-pkg/robot_localization 1cb9533 . ':!test'
    take ros-tooling/keyboard_handler 13072ac
    take ros2/rosbag2 64717ee8 liblz4_vendor mcap_vendor ros2bag rosbag2_compression rosbag2_compression_zstd rosbag2_cpp \
        rosbag2_interfaces rosbag2_py rosbag2_storage rosbag2_storage_mcap rosbag2_storage_sqlite3 rosbag2_transport \
        shared_queues_vendor sqlite3_vendor zstd_vendor
    take osrf/osrf_pycommon d3acec6
    take ros2/launch 09403fce launch launch_xml launch_yaml
    take ros2/launch_ros 62c56e5 launch_ros ros2launch
    take ros2/rosidl_runtime_py df2361f
    take ros2/ros2cli de6cd272 ros2cli ros2interface ros2lifecycle ros2node ros2param ros2pkg ros2run ros2service ros2topic
    take ros/bond_core e6d0fc2 bond bondcpp smclib
    take ros-navigation/navigation2 f4108e5b1 nav2_amcl nav2_common nav2_lifecycle_manager nav2_msgs nav2_util
    # What only tests need would have to be built, too.
    find "$sources" -name package.xml -exec sed -i '/<test_depend/d' {} +
    # rclcpp is compiled four times as fast with its headers compiled once.
    sed -i 's/^add_library(${PROJECT_NAME} .*_SRCS})$/&\ntarget_precompile_headers(${PROJECT_NAME} PRIVATE <rclcpp\/rclcpp.hpp>)/' \
        "$sources/rclcpp/rclcpp/CMakeLists.txt"
    # Of Nav2's 51 messages those that the manager, AMCL, their library and this project use; nothing of this takes a
    # geographic message.
    used='Costmap\|CostmapMetaData\|ClearEntireCostmap\|ManageLifecycleNodes\|NavigateToPose\|NavigateThroughPoses'
    used="$used"'\|FollowPath\|DockRobot\|UndockRobot\|Particle\|ParticleCloud\|SetInitialPose'
    sed -i -e "/^ *\"\(msg\|srv\|action\)\//{/\/\($used\)\./!d}" -e 's/ geographic_msgs//' \
        "$sources/navigation2/nav2_msgs/CMakeLists.txt"
    sed -i '/geographic_msgs/d' "$sources/navigation2/nav2_msgs/package.xml"
    # This bond exports no CMake target.
    sed -i 's/bondcpp::bondcpp/${bondcpp_LIBRARIES}/' "$sources/navigation2/nav2_util/src/CMakeLists.txt"
    sed -i 's/^nav2_package()/&\ninclude_directories(${bondcpp_INCLUDE_DIRS})/' \
        "$sources/navigation2/nav2_util/CMakeLists.txt" "$sources/navigation2/nav2_amcl/CMakeLists.txt"
    mv "$sources" "$work/src"
    rm "$work/part.tar"
}

mkdir -p "$work/install/share/ament_index"
[ -e "$work/wheels.txt" ] || wheels
[ -e "$work/src" ] || sources
cd "$work"
[ $# = 0 ] || set -- --packages-select "$@"
# --as-needed: no library may need the Python parts of the wheels; --allow-shlib-undefined: that of rmw_dds_common needs Python
# without saying so.
exec "$here/overlay.sh" "$venv" install colcon build --continue-on-error --event-handlers console_cohesion- console_stderr- \
    --base-paths src --merge-install --executor parallel --parallel-workers "${JOBS:-2}" "$@" \
    --cmake-args -G Ninja -DBUILD_TESTING=OFF -DCMAKE_BUILD_TYPE=Release "-DCMAKE_CXX_FLAGS_RELEASE=${FLAGS:--O2} -DNDEBUG" \
    -DCMAKE_CXX_STANDARD=17 -DCMAKE_CXX_FLAGS=-w -DCMAKE_C_FLAGS=-w -DCMAKE_SHARED_LINKER_FLAGS=-Wl,--as-needed \
    "-DCMAKE_EXE_LINKER_FLAGS=-Wl,--as-needed -Wl,--allow-shlib-undefined" "-DPython3_EXECUTABLE=$venv/bin/python" \
    "-DPYTHON_EXECUTABLE=$venv/bin/python" -DPython3_FIND_VIRTUALENV=ONLY "-DPython3_ROOT_DIR=$venv" \
    -DCMAKE_POLICY_DEFAULT_CMP0094=NEW --no-warn-unused-cli
