// Reads the code that a node shows: from the camera or a picture. The browser's own reader where
// there is one, else small pictures go to the console, which has them read by a confined process.
// What is found is put into the form of the page, as if it had been typed.

const PREFIX = "ROSSEC:";
const SIDE = 800; // pixels of a frame's longer side
const PICTURE_SIDE = 1600;
const MOST = 250 * 1024; // bytes
const PAUSE = 250; // milliseconds between two frames
const PATIENCE = 120_000;

const find = (name) => document.querySelector(`[data-${name}]`);
const form = find("code");
const video = find("video");
const pause = (time) => new Promise((done) => setTimeout(done, time));
let stream = null;

function tell(element, text) {
  element.textContent = text;
  element.hidden = !text;
}

function found(text) {
  stop();
  form.elements.code.value = text;
  form.requestSubmit();
}

async function detector() {
  if (!("BarcodeDetector" in window)) return null;
  const formats = await BarcodeDetector.getSupportedFormats().catch(() => []);
  return formats.includes("qr_code") ? new BarcodeDetector({ formats: ["qr_code"] }) : null;
}

function drawn(source, width, height, side) {
  const scale = Math.min(1, side / Math.max(width, height));
  const canvas = document.createElement("canvas");
  canvas.width = Math.max(1, Math.round(width * scale));
  canvas.height = Math.max(1, Math.round(height * scale));
  canvas.getContext("2d").drawImage(source, 0, 0, canvas.width, canvas.height);
  return canvas;
}

async function jpeg(canvas) {
  for (const quality of [0.8, 0.5, 0.25]) {
    const blob = await new Promise((done) => canvas.toBlob(done, "image/jpeg", quality));
    if (blob && blob.size <= MOST) return blob;
  }
  throw new Error("The picture is too large. Take it again, from closer.");
}

// The text of the code in a picture, or nothing; `busy` if another one is being read.
async function ask(blob) {
  const answer = await fetch("/add/frame", {
    method: "POST", body: blob, credentials: "same-origin", redirect: "error",
    headers: { Accept: "application/json", "Content-Type": "image/jpeg" },
  }).catch(() => { throw new Error("The console does not answer. Is it still running?"); });
  if (answer.status === 429) return { busy: true };
  if (answer.status === 401) throw new Error("You are no longer logged in. Load the page again.");
  const value = await answer.json().catch(() => ({}));
  if (!answer.ok) {
    const error = new Error([value.error, value.hint].filter(Boolean).join(". ") || "That did not work.");
    error.isPicture = answer.status === 422;
    throw error;
  }
  return value;
}

async function look(reader) {
  if (reader) {
    const codes = await reader.detect(video).catch(() => []);
    const texts = codes.map((code) => code.rawValue).filter((text) => text.startsWith(PREFIX));
    return texts.length === 1 ? texts[0] : "";
  }
  const frame = await jpeg(drawn(video, video.videoWidth, video.videoHeight, SIDE));
  try {
    return (await ask(frame)).text || "";
  } catch (error) {
    if (error.isPicture) return ""; // the next frame may be better
    throw error;
  }
}

function stop() {
  for (const track of stream?.getTracks() ?? []) track.stop();
  stream = null;
  video.hidden = find("stop").hidden = true;
  find("camera").hidden = false;
  tell(find("say"), "");
}

function reason(error) {
  if (error.name === "NotAllowedError") return "The camera may not be used. Allow it for this page, or paste the text.";
  if (error.name === "NotFoundError" || !navigator.mediaDevices) return "There is no camera here. Paste the text, or choose a picture.";
  return error instanceof DOMException ? "The camera does not work. Paste the text, or choose a picture." : error.message;
}

async function scan() {
  const problem = find("problem");
  tell(problem, "");
  find("camera").disabled = true;
  try {
    stream = await navigator.mediaDevices.getUserMedia({
      audio: false, video: { facingMode: "environment", width: { ideal: 1280 }, height: { ideal: 720 } },
    });
    const mine = stream;
    video.srcObject = mine;
    video.hidden = find("stop").hidden = false;
    find("camera").hidden = true;
    await video.play();
    tell(find("say"), "Hold the code into the picture. It is read by itself.");
    const reader = await detector();
    for (const begun = Date.now(); stream === mine; await pause(PAUSE)) {
      const text = video.videoWidth ? await look(reader) : "";
      if (stream !== mine) return;
      if (text) return found(text);
      if (Date.now() - begun > PATIENCE) throw new Error("No code was found. Go closer, or paste the text below it.");
    }
  } catch (error) {
    stop();
    tell(problem, reason(error));
  } finally {
    find("camera").disabled = false;
  }
}

async function read(file) {
  const problem = find("picture-problem");
  tell(problem, "");
  try {
    const picture = await createImageBitmap(file).catch(() => { throw new Error("This is not a picture."); });
    const blob = await jpeg(drawn(picture, picture.width, picture.height, PICTURE_SIDE));
    let answer = await ask(blob);
    for (let tries = 0; answer.busy && tries < 20; tries += 1) {
      await pause(PAUSE);
      answer = await ask(blob);
    }
    if (!answer.text) throw new Error("There is no code of a node in this picture. Go closer, or paste the text below it.");
    found(answer.text);
  } catch (error) {
    tell(problem, error.message);
  }
}

for (const part of document.querySelectorAll("[data-scan]")) part.hidden = false;
find("camera").addEventListener("click", scan);
find("stop").addEventListener("click", stop);
find("picture").addEventListener("change", ({ target }) => target.files[0] && read(target.files[0]));
addEventListener("pagehide", stop);
document.addEventListener("visibilitychange", () => document.hidden && stop());
