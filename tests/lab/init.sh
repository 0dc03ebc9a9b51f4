#!/bin/busybox sh
# First program of the lab's guest: the host's files, read only, become its root.
B=/bin/busybox
$B mount -t proc proc /proc
$B mount -t sysfs sysfs /sys
$B mount -t devtmpfs dev /dev
for module in $($B cat /modules/order); do
    $B insmod /modules/$module || $B echo "no module $module"
done
$B mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,cache=loose,ro host /root || $B poweroff -f
$B mount -t tmpfs run /root/run
$B cp /lab.env /root/run/lab.env
. /lab.env
for folder in proc sys dev; do $B mount --move /$folder /root/$folder; done
exec $B switch_root /root /bin/sh "$FT_LAB_ROOT/tests/lab/guest.sh"
