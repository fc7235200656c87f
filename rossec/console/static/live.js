// A page that says `data-live` is loaded again when anything has changed. Scripts make no HTML, so
// the page comes from the console as at first. Not while a person is at it: then a line says so. A
// page to which nothing comes any more says since when it is old: else it would look alive.

const main = document.querySelector("main[data-live]");
const QUIET = 20_000; // ms; the stream has a sign of life every 5 s, and nothing shows a dead line
const GRACE = 5_000; // to connect again before it is said, and between two tries
const MINUTE = 60_000;

function isInUse() {
  const active = document.activeElement;
  // What went wrong is read, and a page that is loaded again no longer says it. A heading that got
  // the focus when the page was loaded is read, not used.
  if ("busy" in document.body.dataset || document.querySelector("[data-problem]:not([hidden])")) return true;
  return Boolean(active?.matches("a, button, input, select, summary, textarea"));
}

function changed() {
  if (!isInUse()) return location.reload();
  main.querySelector("[data-changed]").hidden = false;
}

function timeOf(moment) {
  const hour = moment.toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" });
  if (moment.toDateString() === new Date().toDateString()) return hour;
  return `${moment.toLocaleDateString("en-GB", { day: "numeric", month: "long" })}, ${hour}`;
}

if (main) {
  const stale = main.querySelector("[data-stale]");
  let known = main.dataset.live || null; // the number the page was made at
  let news = null;
  let heard = new Date(); // when it was true for the last time
  let isLost = false;
  let isFading = false; // the stream broke off: each try to connect again is an error of its own
  let timer = 0; // until it is said that the page is old, then until the time is written anew
  let retry = 0;
  const later = (time) => { clearTimeout(timer); timer = setTimeout(lost, time); };
  const lost = () => {
    isLost = true;
    stale.querySelector("[data-since]").textContent = timeOf(heard);
    stale.hidden = false;
    later(MINUTE); // over midnight the day belongs to it
  };
  const alive = () => {
    heard = new Date();
    isFading = false;
    later(QUIET);
    if (!isLost) return;
    isLost = false;
    stale.hidden = true;
    changed();
  };
  const stop = () => { clearTimeout(timer); clearTimeout(retry); news?.close(); news = null; };
  const start = () => {
    if (news || document.hidden) return;
    later(isLost ? MINUTE : QUIET);
    news = new EventSource("/news");
    news.addEventListener("message", ({ data }) => {
      if (!news) return;
      const isNews = known !== null && known !== data;
      known = data;
      alive();
      if (isNews) changed();
    });
    news.addEventListener("alive", () => news && alive());
    news.addEventListener("silent", () => news && !isLost && lost()); // the authority's service
    news.addEventListener("error", () => {
      if (!news) return;
      if (!isLost && !isFading) later(GRACE);
      isFading = true;
      if (news.readyState === EventSource.CLOSED) again(); // refused: a browser tries no more
    });
  };
  const again = () => {
    news?.close();
    retry = setTimeout(async () => {
      const asked = { headers: { Accept: "text/event-stream" }, cache: "no-store" };
      const answer = await fetch("/news", asked).catch(() => null);
      answer?.body?.cancel().catch(() => {});
      if (answer?.status === 401) { // a console that was started again knows nobody
        if (!isLost) lost();
        if (!isInUse()) return location.reload();
      }
      news = null;
      if (answer?.ok) start();
      else again();
    }, GRACE);
  };
  // What ends is looked at again until it has ended.
  const period = 1000 * Number(main.dataset.again || 0);
  if (period) setInterval(() => !isLost && !document.hidden && !isInUse() && location.reload(), period);
  // A browser has six connections for all pages of a site (HTTP/1.1): pages behind others give
  // theirs back, and hear what they missed when they are seen again.
  document.addEventListener("visibilitychange", () => (document.hidden ? stop() : start()));
  // A person who has left for another page must not be brought back by a reload of this one.
  addEventListener("beforeunload", stop);
  // What is touched while the page is loaded again counts: the loading ends, not what was touched.
  addEventListener("submit", () => { if (!news) { window.stop(); start(); } }, true);
  addEventListener("pagehide", stop);
  addEventListener("pageshow", (event) => { if (event.persisted) location.reload(); });
  start();
}
