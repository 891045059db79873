#!/bin/sh
# overlay.sh VENV OVERLAY COMMAND ...
# Runs a command in a virtual environment with the wheels and in an overlay of ROS packages that were built on them.
set -eu
venv=$(realpath "$1") overlay=$(realpath "$2")
shift 2
if [ ! -e "$overlay/share/ament_index" ]; then
    echo "$overlay is no folder of installed ROS packages: it has no share/ament_index" >&2
    exit 1
fi
unset PYTHONHOME
PATH=$overlay/bin:$venv/bin:/usr/bin:/bin:/usr/sbin:/sbin
site=$(python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
python=$(basename "$(dirname "$site")")
PYTHONPATH=$overlay/lib/$python/site-packages:$overlay/local/lib/$python/dist-packages
LD_LIBRARY_PATH=$overlay/lib:$venv/lib
for folder in "$overlay"/opt/*/lib "$site"/ros_*.libs; do
    [ ! -d "$folder" ] || LD_LIBRARY_PATH=$LD_LIBRARY_PATH:$folder
done
AMENT_PREFIX_PATH=$overlay:$venv
ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3 RMW_IMPLEMENTATION=rmw_fastrtps_cpp
# The wheels' own set-up would put them before the overlay.
_ROS_WHEELS_BOOTSTRAP_COMPLETE=1
# The wheel of rmw_dds_common needs Python's library without saying so; a node in C++ does not have it.
library=$(python -c 'import sysconfig; v = sysconfig.get_config_var; print(v("LIBDIR") + "/" + v("INSTSONAME"))')
case $library in *.so*) export LD_PRELOAD="$library" ;; esac
export PATH PYTHONPATH LD_LIBRARY_PATH AMENT_PREFIX_PATH
export ROS_DISTRO ROS_VERSION ROS_PYTHON_VERSION RMW_IMPLEMENTATION _ROS_WHEELS_BOOTSTRAP_COMPLETE
exec "$@"
