# Runs in the lab's guest after init.sh: mounts what drivers need, runs every case, powers off.
. /run/lab.env
export FT_LAB_ROOT FT_LAB_KERNEL FT_LAB_BIN FT_LAB_ONLY FT_LAB_PYTHON
export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/run TMPDIR=/run RUST_BACKTRACE=0
mkdir -p /dev/pts
mount -t devpts devpts /dev/pts
ip link set lo up
# Verdicts leave by the second serial port, what else is said by the first.
"$FT_LAB_BIN/lab-guest" >/dev/ttyS1 2>/dev/ttyS0
echo "lab-guest ended with code $?" >/dev/ttyS0
echo o >/proc/sysrq-trigger
sleep 60
