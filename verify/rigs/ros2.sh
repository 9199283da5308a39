# Sourced by the rigs that run nodes of ROS 2.

. "$(dirname "$(realpath "${BASH_SOURCE[0]}")")/common.sh"
provide python3=python3 cc=gcc g++=g++ ip=iproute2
python3 -c 'import ensurepip' 2>/dev/null || apt install -y --no-install-recommends python3-venv

# ros_environment DISTRIBUTION: a virtual environment with rclpy of `kilted` or `jazzy`, and motord_msgs in its folder `messages`.
ros_environment() {
    local messages=$tree/bridge/motord_msgs made prefix=ros- packages
    ros=$cache_root/ros2-$1
    [ "$1" = kilted ] || prefix=ros-$1-
    # ament_package and its like are needed, and no package names them.
    packages=(rclpy rmw-fastrtps-cpp std-msgs std-srvs sensor-msgs diagnostic-msgs trajectory-msgs builtin-interfaces ament-cmake
        ament-package ament-cmake-include-directories rosidl-default-generators rosidl-core-generators rosidl-default-runtime)
    case $1 in
        kilted) packages+=(ament-cmake-ros-core) ;;
        jazzy) packages+=(ament-cmake-ros ament-cmake-gmock ament-cmake-gtest ament-cmake-pytest domain-coordinator python-cmake-module) ;;
    esac
    made=$(echo "${packages[@]}" | cat - "$messages"/*.* "$messages"/msg/* | sha256sum)
    [ "$(cat "$ros/made" 2>/dev/null)" != "$made" ] || return 0
    python3 -m venv "$ros"
    "$ros/bin/pip" --disable-pip-version-check --quiet install numpy pyyaml cmake ninja empy==3.3.4 lark catkin_pkg cyclonedds \
        "${packages[@]/#/$prefix}"
    build_messages "$messages"
    echo "$made" >"$ros/made"
}

# build_messages PACKAGE: the wheels name folders of the machine that built them: each missing one becomes a link to ours, or an empty one.
build_messages() {
    local missing log=$ros/configure.log
    export PATH=$ros/bin:$PATH AMENT_PREFIX_PATH=$ros CMAKE_PREFIX_PATH=$ros
    for _ in 1 2 3 4 5; do
        rm -rf "$ros/build"
        cmake -S "$1" -B "$ros/build" -G Ninja -DCMAKE_INSTALL_PREFIX="$ros/messages" -DPython3_EXECUTABLE="$ros/bin/python" \
            -DBUILD_TESTING=OFF >"$log" 2>&1 && break
        missing=$(grep -A6 'non-existent path' "$log" | grep -oE '"/[^"]+"' | head -n 1 | tr -d '"' || true)
        [ -n "$missing" ] || { cat "$log"; fail "motord_msgs cannot be configured"; }
        mkdir -p "$(dirname "$missing")"
        case $missing in
            */include/python3.*) ln -sfn "$(python -c 'import sysconfig; print(sysconfig.get_path("include"))')" "$missing" ;;
            *) mkdir -p "$missing" ;;
        esac
    done
    { cmake --build "$ros/build" && cmake --install "$ros/build"; } >"$log" 2>&1 || { cat "$log"; fail "motord_msgs cannot be built"; }
}

# enter_ros2: opens $work for the programs in RIG_BIN, rclpy of Kilted and motord_msgs, in a network namespace: multicast reaches nothing
# but its loopback.
enter_ros2() {
    bin=$RIG_BIN
    ip link set lo up multicast on
    ip route add 224.0.0.0/4 dev lo
    open_work
    cd "$work"
    PATH=$bin:$PATH
    export MOTORD_RUNTIME_DIR=$work/run MOTORD_INSTANCE=demo PYTHONDONTWRITEBYTECODE=1
    use_ros2 kilted
    mkdir run
    go_first -15
}

# use_ros2 DISTRIBUTION: `python` is that of its environment, with rclpy and motord_msgs.
use_ros2() {
    ros=$cache_root/ros2-$1
    PATH=$ros/bin:$PATH
    export AMENT_PREFIX_PATH=$ros/messages:$ros LD_LIBRARY_PATH=$ros/messages/lib
    PYTHONPATH=$(dirname "$(find "$ros/messages" -type d -path '*-packages/motord_msgs')")
    export PYTHONPATH
}
