// Replays the runs of a page of results. All data are in the page: nothing is loaded.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("runs").textContent);
  const dialog = document.getElementById("replay");
  const [title, canvas, slider, toggle, told] = ["title", "map", "time", "toggle", "told"].map(
    (name) => dialog.querySelector(`[data-part="${name}"]`));
  const context = canvas.getContext("2d");
  const NEVER = 255, PLAY_SECONDS = 15;
  let run = null, time = 0, timer = null;

  // The pixels of a picture, as numbers.
  const pixels = async (source) => {
    const image = new Image();
    image.src = source;
    await image.decode();
    const place = document.createElement("canvas");
    [place.width, place.height] = [image.width, image.height];
    const inside = place.getContext("2d");
    inside.drawImage(image, 0, 0);
    return inside.getImageData(0, 0, image.width, image.height);
  };

  // The last index at or before an instant.
  const indexAt = (times, instant) => {
    let [low, high] = [0, times.length];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= instant + 1e-6) low = middle; else high = middle;
    }
    return low;
  };

  const draw = () => {
    const { map, seen, width, height, scale } = run;
    const shown = new ImageData(width, height), index = indexAt(run.seen_time, time);
    for (let pixel = 0; pixel < 4 * width * height; pixel += 4) {
      const first = seen.data[pixel], known = first !== NEVER && first <= index;
      for (let part = 0; part < 3; part++) {
        shown.data[pixel + part] = known ? map.data[pixel + part] : data.unknown[part];
      }
      shown.data[pixel + 3] = 255;
    }
    run.small.getContext("2d").putImageData(shown, 0, 0);
    context.imageSmoothingEnabled = false;
    context.drawImage(run.small, 0, 0, canvas.width, canvas.height);
    const last = indexAt(run.time, time);
    const size = Math.max(4, scale * run.radius);
    run.inks.forEach((ink, robot) => {
      const across = run.across[robot], down = run.down[robot];
      context.strokeStyle = context.fillStyle = ink;
      context.lineWidth = Math.max(1.5, scale);
      context.beginPath();
      for (let point = 0; point <= last; point++) {
        context.lineTo(scale * across[point], scale * down[point]);
      }
      context.stroke();
      context.beginPath();
      context.arc(scale * across[last], scale * down[last], size, 0, 2 * Math.PI);
      context.fill();
    });
    slider.value = time;
    told.textContent = `${time.toFixed(1)} s, ${(100 * run.coverage[last]).toFixed(1)} %`;
  };

  const end = () => run.time[run.time.length - 1];
  const stop = () => { clearInterval(timer); timer = null; toggle.textContent = "Play"; };
  const play = () => {
    stop();
    if (time >= end()) time = 0;
    toggle.textContent = "Pause";
    const speed = end() / PLAY_SECONDS, started = performance.now(), before = time;
    timer = setInterval(() => {
      time = Math.min(end(), before + ((performance.now() - started) / 1000) * speed);
      draw();
      if (time >= end()) stop();
    }, 40);
  };

  const show = async (number) => {
    stop();
    const chosen = data.runs[number];
    const [map, seen] = await Promise.all([pixels(data.maps[chosen.map]), pixels(chosen.seen)]);
    const { width, height } = seen, small = document.createElement("canvas");
    const scale = Math.max(1, Math.floor(900 / Math.max(width, height)));
    [small.width, small.height] = [width, height];
    [canvas.width, canvas.height] = [scale * width, scale * height];
    run = { ...chosen, map, seen, width, height, scale, small };
    title.textContent = chosen.title;
    slider.max = end();
    time = 0;
    draw();
    if (!dialog.open) dialog.showModal();
    play();
  };

  for (const button of document.querySelectorAll("button[data-run]")) {
    button.addEventListener("click", () => show(Number(button.dataset.run)));
  }
  toggle.addEventListener("click", () => (timer === null ? play() : stop()));
  slider.addEventListener("input", () => { stop(); time = Number(slider.value); draw(); });
  dialog.addEventListener("close", stop);
})();
