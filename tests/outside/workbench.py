"""The workbench in Debian's Chromium, driven by Selenium (PyPI) and looked at by axe-core (npm).

    workbench.py story RADCAM DATASET [PICTURES]   a campaign: open, evidence, add, error falls, undo, own effect, two tabs, restart, save
    workbench.py camera RADCAM CAMERA FOLDER [PICTURES]   a camera: live picture, settings, cancel, capture, verdict
    workbench.py law RADCAM DATASET [PICTURES]     what has no name: the law, added by its button, and the error falls
    workbench.py broken RADCAM DATASET             what a dataset that cannot be read says
    workbench.py history RADCAM STORE [PICTURES]   what a monitor kept
    workbench.py pages FILE.html...                reports: no request, no violation, nothing wider than the window

Prints JSON of what was seen; PICTURES is a folder for screenshots at 1440, 1024 and 390 px, light and dark.
"""

import json
import os
import re
import subprocess
import sys
import time

from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

AXE = open(os.environ["RADCAM_TEST_AXE"]).read()
ARGUMENTS = """--headless=new --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-component-update
    --disable-sync --disable-quic --hide-scrollbars --disable-dev-shm-usage""".split()


class Browser:
    def __init__(self, pictures=None):
        options = Options()
        options.binary_location = "/usr/bin/chromium"
        for argument in ARGUMENTS:
            options.add_argument(argument)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service("/usr/bin/chromedriver"))
        self.pictures, self.foreign, self.violations, self.said, self.wide = pictures, set(), [], [], []
        self.shape(1440)

    def shape(self, width, dark=False, height=1000):
        media = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": media})
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def all(self, selector):
        return self.driver.find_elements(By.CSS_SELECTOR, selector)

    def text(self, selector):
        """Text of the first that matches; parts of the page are replaced while it is read."""
        script = "const e = document.querySelector(arguments[0]); return e ? e.innerText : null"
        return self.driver.execute_script(script, selector)

    def value(self, selector):
        return self.driver.execute_script("return document.querySelector(arguments[0])?.value", selector)

    def error(self):
        return float(self.value("#error data") or "nan")

    def heading(self):
        return self.text("h1") or ""

    def wait(self, what, condition, seconds=60):
        end = time.time() + seconds
        while time.time() < end:
            found = condition()
            if found:
                return found
            time.sleep(0.05)
        raise SystemExit(f"waited {seconds} s for: {what}\n{self.text('body')[:3000]}")

    def click(self, selector, holding=""):
        find = """return [...document.querySelectorAll(arguments[0])].find(e => e.innerText.includes(arguments[1]) && !e.disabled)"""

        def clicked():
            try:
                element = self.driver.execute_script(find, selector, holding)
                self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
                element.click()
                return True
            except Exception:  # not there yet, or replaced while it was looked at
                return False

        self.wait(f"{selector} {holding}", clicked)

    def type(self, selector, text):
        def typed():
            try:
                element = self.all(selector)[0]
                element.clear()
                element.send_keys(text)
                return element.get_attribute("value") == text
            except Exception:  # replaced while it was typed into
                return False

        self.wait(f"{selector} takes {text}", typed)

    def press(self, selector, key):
        try:
            self.driver.execute_script("document.querySelector(arguments[0]).focus()", selector)
            self.driver.switch_to.active_element.send_keys(key)
            return True
        except Exception:  # replaced while it was looked at
            return False

    def look(self, name):
        """axe on the page as it is, its requests, whether it is wider than the window, pictures."""
        self.driver.execute_script(AXE)
        script = "const done = arguments[0]; axe.run().then(r => done(r.violations.map(v => [v.id, v.impact, v.nodes[0].html.slice(0, 200)])))"
        for violation in self.driver.execute_async_script(script):
            self.violations.append([name, *violation])
        self.requests()
        shapes = [(1440, False), (1440, True), (1024, False), (390, False), (390, True)] if self.pictures else [(1440, False), (390, True)]
        for width, dark in shapes:
            self.shape(width, dark)
            time.sleep(0.3)
            inner = self.driver.execute_script("return document.documentElement.scrollWidth")
            if inner > width:
                self.wide.append([name, width, inner])
            if self.pictures:
                height = self.driver.execute_script("return document.documentElement.scrollHeight")
                self.shape(width, dark, min(height, 8000))
                time.sleep(0.5)
                self.driver.save_screenshot(f"{self.pictures}/{name}-{width}-{'dark' if dark else 'light'}.png")
        self.shape(1440)

    def requests(self):
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                url = message["params"]["request"]["url"]
                if not re.match(r"(http://127\.0\.0\.1:\d+/|data:|blob:|file://|chrome:|about:)", url):
                    self.foreign.add(url)
        self.said += [e["message"] for e in self.driver.get_log("browser") if e["level"] == "SEVERE"]

    def result(self, **seen):
        self.driver.quit()
        return dict(seen, foreign=sorted(self.foreign), violations=self.violations, console=self.said, wide=self.wide)


class Workbench:
    def __init__(self, *arguments):
        self.process = subprocess.Popen([*arguments], stdout=subprocess.PIPE, text=True)
        self.url = self.process.stdout.readline().strip()

    def __enter__(self):
        return self

    def end(self, browser):
        """Ends it; what the browser's console says of a server that answers no more is no error of the page."""
        browser.requests()
        self.process.terminate()
        self.process.wait(30)
        time.sleep(0.5)
        browser.driver.get_log("browser")

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()

    def page(self, room):
        return self.url.split("?")[0].rstrip("/") + room


def story(radcam, dataset, pictures=None):
    b = Browser(pictures)
    seen = {}
    error, heading = b.error, b.heading
    with Workbench(radcam, "workbench", dataset) as w:
        b.driver.get(w.url)
        seen["address"] = b.driver.current_url
        b.wait("a verdict", lambda: heading().startswith("The camera shows"))
        seen["heading"], seen["sentence"], seen["error_before"] = heading(), b.text("p.verdict"), error()
        b.look("1-open")
        # The evidence: a strong cell of the picture.
        b.click("button.cell", "+7")
        b.wait("the cell's curve", lambda: b.text("section.detail"))
        seen["cell"] = b.text("section.detail")
        b.wait("an interactive figure", lambda: b.all("section.detail figure.live"))
        b.look("2-evidence")
        b.click("button.first", "Add")
        b.wait("the error falls", lambda: error() < 1.1)
        b.wait("it is searched again", lambda: heading() == "The model describes the camera")
        b.wait("the cell stays in view, with its new numbers", lambda: "first, now" in (b.text("section.detail") or "").lower())
        seen["error_after"], seen["rungs"] = error(), len(b.all(".rung:not(.axis)"))
        b.look("3-added")
        # A reload shows the same, and so does a second tab, which hears of a switch in the first.
        b.driver.refresh()
        seen["error_reloaded"] = error()
        first = b.driver.current_window_handle
        b.driver.switch_to.new_window("tab")
        b.driver.get(w.page("/"))
        second = b.driver.current_window_handle
        seen["error_second_tab"] = error()
        b.driver.switch_to.window(first)
        # By the keyboard.
        b.wait("the switch takes the keyboard", lambda: b.press("button.switch", Keys.SPACE))
        b.wait("it is off", lambda: error() > 1.2)
        b.driver.switch_to.window(second)
        b.wait("the second tab hears of it", lambda: error() > 1.2)
        seen["error_switched_off"] = error()
        b.driver.close()
        b.driver.switch_to.window(first)
        b.click("#undo")
        b.wait("the step is taken back", lambda: error() < 1.1)
        # One's own effect: what cannot be understood is said, what can is tried.
        b.type("input[name=formula]", "k * nonsense")
        b.click("form.own button", "Try")
        seen["refused"] = b.wait("a refusal", lambda: b.text("#tried [role=alert]"))
        b.type("input[name=formula]", "k * mu^2")
        b.click("form.own button", "Try")
        seen["tried"] = b.wait("an answer", lambda: b.text("#tried [role=status]"))
        b.driver.get(w.page("/data"))
        b.wait("the frame", lambda: "mean" in (b.text("#v-statistics") or ""))
        b.click("#v-image")
        seen["pixel"] = b.wait("a pixel", lambda: "x " in (b.text("#v-pixel") or "") and b.text("#v-pixel"))
        for of in ["difference", "variance"]:
            b.driver.execute_script("const s = document.querySelector('#v-of'); s.value = arguments[0]; s.dispatchEvent(new Event('change'))", of)
            before = seen.get("statistics")
            seen["statistics"] = b.wait(of, lambda: b.text("#v-statistics") != before and b.text("#v-statistics"))
        b.look("4-data")
        b.driver.get(w.page("/save"))
        b.look("5-save")
        w.end(b)
    # After a restart the same lies there.
    with Workbench(radcam, "workbench", dataset) as w:
        b.driver.get(w.url)
        b.wait("the model", lambda: error() < 1.1)
        seen["error_restarted"] = error()
        w.end(b)
    b.wait("its end is said", lambda: "does not answer" in (b.text("#said") or ""))
    print(json.dumps(b.result(**seen)))


def camera(radcam, name, folder, pictures=None):
    b = Browser(pictures)
    seen = {}
    with Workbench(radcam, "workbench", folder, "--camera", name) as w:
        b.driver.get(w.url)
        seen["empty"] = b.text("h1")
        b.driver.get(w.page("/camera"))
        number = lambda: int(b.text("#live-frame").replace("–", "0") or 0)  # noqa: E731
        b.wait("a live picture", lambda: number() > 0)
        first = number()
        b.wait("it moves", lambda: number() > first)
        b.type("input[name=exposure_ms]", "2")
        b.click(".side form button")
        seen["set"] = b.wait("the camera reports", lambda: b.text("#set p"))
        b.look("6-camera")
        b.type("input[name=exposure_ms]", "much")
        b.click(".side form button")
        seen["refused"] = b.wait("a refusal", lambda: b.text("#set [role=alert]"))
        b.click("form.own button.first", "Capture")
        b.wait("it captures", lambda: re.search(r"capturing: [1-9]", b.text("#status") or ""))
        b.click("#cancel")
        seen["cancelled"] = b.wait("it ends", lambda: b.text("#status .error"))
        b.click("form.own button.first", "Capture")
        b.wait("live while it captures", lambda: "capturing" in (b.text("#status") or "") and number() > 0)
        b.driver.get(w.page("/"))
        b.wait("a verdict", lambda: (b.text("h1") or "").startswith("The "), 240)
        seen["heading"] = b.text("h1")
        b.look("7-captured")
        w.end(b)
    print(json.dumps(b.result(**seen)))


def law(radcam, dataset, pictures=None):
    b = Browser(pictures)
    seen = {}
    error, heading = b.error, b.heading
    with Workbench(radcam, "workbench", dataset) as w:
        b.driver.get(w.url)
        b.wait("the law", lambda: b.all("#add-law"))
        seen["heading"], seen["sentence"], seen["error_before"] = heading(), b.text("p.verdict"), error()
        b.look("9-no-name")
        b.click("#add-law")
        b.wait("the error falls", lambda: error() < 1.1)
        b.wait("it is searched again", lambda: heading() == "The model describes the camera")
        seen["error_after"], seen["rungs"] = error(), len(b.all(".rung:not(.axis)"))
        b.look("10-law")
        w.end(b)
    print(json.dumps(b.result(**seen)))


def broken(radcam, dataset):
    b = Browser()
    with Workbench(radcam, "workbench", dataset) as w:
        b.driver.get(w.url)
        said = b.wait("an error", lambda: b.text("#main [role=alert]"))
        w.end(b)
    print(json.dumps(b.result(said=said)))


def history(radcam, store, pictures=None):
    b = Browser(pictures)
    with Workbench(radcam, "workbench", "--history", store) as w:
        b.driver.get(w.url)
        b.wait("figures", lambda: b.driver.find_elements("css selector", "figure"))
        b.look("8-history")
        w.end(b)
    print(json.dumps(b.result()))


def pages(*files):
    b = Browser()
    for file in files:
        b.driver.get("file://" + os.path.abspath(file))
        b.look(os.path.basename(file))
    b.requests()
    print(json.dumps(b.result()))


if __name__ == "__main__":
    {"story": story, "camera": camera, "law": law, "broken": broken, "history": history, "pages": pages}[sys.argv[1]](*sys.argv[2:])
