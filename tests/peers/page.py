"""Presses the buttons of a running ft-capture's live page in a headless Chromium and prints what it saw as one JSON object.

    page.py CHROMIUM URL [FOLDER]

FOLDER receives screenshots at desktop and phone size. Nothing may be being recorded at the start.
"""

import json
import sys
import time

from browser import Browser


def main():
    program, url = sys.argv[1:3]
    folder = sys.argv[3] if len(sys.argv) > 3 else None
    seen = {}
    with Browser(program) as browser:
        browser.resize(1280, 860)
        browser.call("Page.navigate", url=url)
        browser.wait_for("window.ftStats && ftStats.frames > 20")
        browser.wait_for("document.querySelector('#link').textContent === 'live'")
        browser.wait_for("!document.querySelector('#start').disabled")
        seen["address"] = browser.js("location.href")
        seen["recording before"] = browser.js("document.querySelector('#recording').textContent")

        browser.click("#start")
        browser.wait_for("document.querySelector('#recording').classList.contains('on')")
        seen["recording"] = browser.js("document.querySelector('#recording').textContent")
        browser.click("#tare")
        browser.wait_for("document.querySelector('#answer').textContent === 'marked tare'")
        browser.click("#text")
        browser.type("hinge squeaks <b>here</b>")
        browser.click("#mark")
        browser.wait_for("document.querySelector('#marks').innerText.includes('hinge squeaks <b>here</b>')")
        browser.click(".quick[data-mark=grasp]")
        browser.wait_for("document.querySelector('#answer').textContent === 'marked grasp'")

        frames, drawn = browser.js("[ftStats.frames, ftStats.drawn]")
        begun = time.monotonic()
        time.sleep(5)
        seconds = time.monotonic() - begun
        frames_then, drawn_then = browser.js("[ftStats.frames, ftStats.drawn]")
        seen["frames_hz"], seen["drawn_hz"] = (frames_then - frames) / seconds, (drawn_then - drawn) / seconds
        if folder:
            browser.js("scrollTo(0, 0)")
            time.sleep(0.3)
            browser.screenshot(f"{folder}/desktop.png")
        browser.resize(390, 844, 2, True)
        if folder:
            browser.js("scrollTo(0, 0)")
            time.sleep(0.3)
            browser.screenshot(f"{folder}/phone.png")
            browser.js("document.querySelector('#tables').scrollIntoView()")
            time.sleep(0.3)
            browser.screenshot(f"{folder}/phone-below.png")
        seen["sideways"] = browser.js("document.documentElement.scrollWidth - document.documentElement.clientWidth")

        browser.click("#stop")
        time.sleep(0.3)
        seen["after one press"] = browser.js("document.querySelector('#recording').classList.contains('on')")
        browser.click("#stop")
        browser.wait_for("document.querySelector('#answer').textContent.startsWith('finished')")
        browser.wait_for("document.querySelector('#recording').textContent === 'not recording'")
        seen["answer"] = browser.js("document.querySelector('#answer').textContent")
        seen["devices"] = browser.js("document.querySelector('#devices').innerText")
        seen["lost"] = browser.js("ftStats.lost")
        seen["errors"] = browser.errors
    print(json.dumps(seen))


main()
