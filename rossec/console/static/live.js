// A page that says `data-live` is loaded again when anything has changed. Scripts make no HTML, so
// the page comes from the console as at first. Not while a person is at it: then a line says so.

const main = document.querySelector("main[data-live]");

function isInUse() {
  const active = document.activeElement;
  // A heading that got the focus when the page was loaded is read, not used.
  return "busy" in document.body.dataset || Boolean(active?.matches("a, button, input, select, summary, textarea"));
}

function changed() {
  if (!isInUse()) return location.reload();
  main.querySelector("[data-changed]").hidden = false;
}

if (main) {
  let known = main.dataset.live || null; // the number the page was made at
  let news = null;
  const stop = () => { news?.close(); news = null; };
  const start = () => {
    if (news || document.hidden) return;
    news = new EventSource("/news");
    news.addEventListener("message", ({ data }) => {
      if (!news) return;
      if (known === null) known = data;
      else if (known !== data) { known = data; changed(); }
    });
  };
  // A browser has six connections for all pages of a site (HTTP/1.1): pages behind others give
  // theirs back, and hear what they missed when they are seen again.
  document.addEventListener("visibilitychange", () => (document.hidden ? stop() : start()));
  // A person who has left for another page must not be brought back by a reload of this one.
  addEventListener("beforeunload", stop);
  addEventListener("pagehide", stop);
  addEventListener("pageshow", (event) => { if (event.persisted) location.reload(); });
  start();
}
