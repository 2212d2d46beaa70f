"""What the workbench and the report cost: a switch of an effect on 232 frames, the live picture of a served camera while it captures, and a report of
a 5-megapixel campaign.

    RADCAM_TEST_AXE=target/axe.min.js target/venv/bin/python benches/workbench.py target/release/radcam DATASET
"""

import http.client
import os
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "tests" / "outside"))
from workbench import Browser, Workbench  # noqa: E402

FORM = {"Content-Type": "application/x-www-form-urlencoded"}


def switches(radcam, dataset):
    """Seconds from the click's request to the whole page of the answer."""
    with Workbench(radcam, "workbench", dataset) as w:
        host, token = w.url.removeprefix("http://").split("/?token=")
        headers = {"Cookie": f"radcam-{host.split(':')[1]}={token}"}

        def ask(method, path, body=None):
            connection = http.client.HTTPConnection(host)
            connection.request(method, path, body, {**headers, **(FORM if body else {})})
            answer = connection.getresponse().read().decode()
            connection.close()
            return answer

        while "class=\"job\"" in ask("GET", "/status") or 'id="error"' not in ask("GET", "/"):
            time.sleep(0.1)
        effect = "interpixel-crosstalk"
        ask("POST", "/model/add", f"effect={effect}")
        times = []
        for _ in range(20):
            while "class=\"job\"" in ask("GET", "/status"):
                time.sleep(0.05)
            begun = time.perf_counter()
            answer = ask("POST", "/model/switch", f"effect={effect}")
            times.append(time.perf_counter() - begun)
            assert 'id="error"' in answer
    times.sort()
    print(f"a switch: median of 20 {1e3 * statistics.median(times):.0f} ms, longest {1e3 * times[-1]:.0f} ms")


def live(radcam, folder):
    served = subprocess.Popen([radcam, "serve", "cmos12", "--interface", "127.0.0.1", "--serial", "BENCH"], stdout=subprocess.PIPE, text=True)
    served.stdout.readline()
    browser = Browser()
    try:
        with Workbench(radcam, "workbench", folder, "--camera", "aravis:127.0.0.1") as w:
            browser.driver.get(w.url)
            browser.driver.get(w.page("/camera"))
            browser.wait("a live picture", lambda: float(browser.text("#live-rate").replace("–", "0")) > 0)
            time.sleep(4)
            print(f"live at 1024 x 768: {browser.text('#live-rate')} pictures a second")
            browser.driver.execute_script("document.querySelector('select[name=plan]').value = 'quick'")
            browser.type("input[name=frames]", "60")
            browser.click("form.own button.first", "Capture")
            browser.wait("it captures", lambda: "capturing: " in (browser.text("#status") or ""))
            rates = []
            while "capturing" in (browser.text("#status") or ""):
                rates.append(float(browser.text("#live-rate").replace("–", "0") or 0))
                time.sleep(0.3)
            rates = rates or [0.0]
            print(f"while it captures: {statistics.median(rates):.1f} pictures a second (median of {len(rates)} readings)")
            print(open(os.path.join(folder, "capture.log")).read().strip().splitlines()[-1])
            w.end(browser)
        # The same capture without a page.
        alone = folder + "-alone"
        plan = alone + ".toml"
        text = open(os.path.join(folder, "plan.toml")).read()
        open(plan, "w").write(text)
        subprocess.run([radcam, "capture", "--camera", "aravis:127.0.0.1", "--plan", plan, "-o", alone], stdout=subprocess.DEVNULL, check=True)
        print("without a page: " + open(os.path.join(alone, "capture.log")).read().strip().splitlines()[-1])
    finally:
        browser.driver.quit()
        served.kill()


def report(radcam, folder):
    model = os.path.join(folder, "five.toml")
    text = subprocess.run([radcam, "model", "new", model, "--sensor", "cmos12"], capture_output=True, text=True, check=True)
    del text
    lines = open(model).read().splitlines()
    lines = ["width = 2592" if line.startswith("width") else "height = 1944" if line.startswith("height") else line for line in lines]
    open(model, "w").write("\n".join(lines) + "\n")
    data, page = os.path.join(folder, "five"), os.path.join(folder, "five.html")
    subprocess.run([radcam, "simulate", model, "--plan", "quick", "-o", data], capture_output=True, check=True)
    begun = time.perf_counter()
    done = subprocess.run([radcam, "report", data, "-o", page], capture_output=True)
    assert done.returncode in (0, 1), done.stderr
    made = time.perf_counter() - begun
    browser = Browser()
    times = []
    for _ in range(5):
        begun = time.perf_counter()
        browser.driver.get("file://" + page)
        browser.wait("it is whole", lambda: browser.driver.execute_script("return document.readyState") == "complete")
        browser.driver.execute_script("document.querySelector('figure').scrollIntoView()")
        browser.wait("its first figure", lambda: browser.all("figure.live"))
        times.append(time.perf_counter() - begun)
    browser.driver.quit()
    size = os.path.getsize(page) / 1e6
    frames = sum(1 for _ in open(os.path.join(data, "frames.csv"))) - 1
    print(f"a report of {frames} frames of 2592 x 1944: made in {made:.1f} s, {size:.1f} MB, open in {statistics.median(times):.2f} s (median of 5)")


if __name__ == "__main__":
    radcam, dataset = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copytree(dataset, os.path.join(folder, "dataset"))
        switches(radcam, copy)
        live(radcam, os.path.join(folder, "captured"))
        report(radcam, folder)
