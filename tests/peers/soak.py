"""Keeps a live page open in a headless Chromium and measures every few seconds; prints one JSON object.

    soak.py CHROMIUM URL SERVER_PID SECONDS [FOLDER]

Memory is taken after a garbage collection: the page's heap (bytes), and what the server holds (kB). The server's share of a
core is taken before the page is opened, too. FOLDER receives a screenshot at desktop and one at phone size.
"""

import json
import sys
import time

from browser import Browser


def server(pid):
    """Resident memory, kB, and processor time, s."""
    with open(f"/proc/{pid}/status") as status:
        kilobytes = next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))
    with open(f"/proc/{pid}/stat") as stat:
        fields = stat.read().rsplit(")", 1)[1].split()
    return kilobytes, (int(fields[11]) + int(fields[12])) / 100


def main():
    program, url, pid, seconds = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
    folder = sys.argv[5] if len(sys.argv) > 5 else None
    samples = []
    with Browser(program) as browser:
        browser.resize(1280, 860)
        begin, (_, before_s) = time.monotonic(), server(pid)
        time.sleep(max(4.0, seconds / 30))
        alone = (server(pid)[1] - before_s) / (time.monotonic() - begin)
        browser.call("Page.navigate", url=url)
        browser.wait_for("window.ftStats && ftStats.frames > 100", 30)
        begin = time.monotonic()
        period = max(2.0, seconds / 60)
        while time.monotonic() - begin < seconds:
            browser.call("HeapProfiler.collectGarbage")
            heap = browser.call("Runtime.getHeapUsage")["usedSize"]
            frames, drawn, lost = browser.js("[ftStats.frames, ftStats.drawn, ftStats.lost]")
            kilobytes, processor_s = server(pid)
            samples.append({
                "at_s": time.monotonic() - begin, "heap": heap, "frames": frames, "drawn": drawn, "lost": lost,
                "server_kB": kilobytes, "server_s": processor_s, "nodes": browser.js("document.querySelectorAll('*').length"),
            })
            time.sleep(period)
        if folder:
            browser.screenshot(f"{folder}/desktop.png")
            browser.resize(390, 844, 2, True)
            browser.screenshot(f"{folder}/phone.png")
        errors = browser.errors
    print(json.dumps({"alone": alone, "samples": samples, "errors": errors}))


main()
