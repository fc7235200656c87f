// Passkeys: approving, logging in, setting up a phone. A form says what it is for by a data
// attribute; texts are set as text, never as HTML. What is asked and what it means is decided by
// the authority's service, which verifies every answer.

const bytes = (text) =>
  Uint8Array.from(atob(text.replace(/-/g, "+").replace(/_/g, "/")), (char) => char.charCodeAt(0));
const base64url = (buffer) =>
  btoa(String.fromCharCode(...new Uint8Array(buffer)))
    .replace(/\+/g, "-").replace(/\//g, "_").replace(/=+$/, "");

class Refused extends Error {}

// What the authority says is as in a terminal: it begins small and has no full stop.
const sentence = (text) => text[0].toUpperCase() + text.slice(1) + (/[.?!]$/.test(text) ? "" : ".");

async function post(path, body) {
  const isForm = body instanceof URLSearchParams;
  const answer = await fetch(path, {
    method: "POST",
    headers: { Accept: "application/json", ...(isForm ? {} : { "Content-Type": "application/json" }) },
    body: isForm ? body : JSON.stringify(body),
    credentials: "same-origin",
    redirect: "error",
  }).catch(() => { throw new Refused("The console does not answer. Is it still running?"); });
  const value = await answer.json().catch(() => ({}));
  if (answer.status === 401) throw new Refused("You are no longer logged in. Load the page again.");
  if (!answer.ok) throw new Refused([value.error, value.hint].filter(Boolean).map(sentence).join(" ") || "That did not work.");
  return value;
}

async function assertion(asked) {
  const found = await navigator.credentials.get({
    publicKey: {
      challenge: bytes(asked.challenge),
      rpId: asked.rpId,
      timeout: asked.timeout,
      userVerification: "required",
      allowCredentials: asked.credentials.map((id) => ({ type: "public-key", id: bytes(id) })),
    },
  });
  return {
    credential: base64url(found.rawId),
    clientData: base64url(found.response.clientDataJSON),
    authenticatorData: base64url(found.response.authenticatorData),
    signature: base64url(found.response.signature),
  };
}

async function registration(asked, name) {
  const made = await navigator.credentials.create({
    publicKey: {
      challenge: bytes(asked.challenge),
      rp: { id: asked.rpId, name: "rossec" },
      user: { id: crypto.getRandomValues(new Uint8Array(16)), name, displayName: name },
      pubKeyCredParams: [{ type: "public-key", alg: -7 }],
      timeout: asked.timeout,
      attestation: "none",
      authenticatorSelection: { residentKey: "required", userVerification: "required" },
      excludeCredentials: asked.credentials.map((id) => ({ type: "public-key", id: bytes(id) })),
    },
  });
  return {
    id: asked.id,
    name,
    clientData: base64url(made.response.clientDataJSON),
    attestation: base64url(made.response.attestationObject),
  };
}

async function approve(form, fields) {
  const asked = await post(form.action, fields);
  return post(`/approve/${asked.id}`, await assertion(asked));
}

async function logIn() {
  const asked = await post("/login/challenge", {});
  return post("/login/passkey", { id: asked.id, ...(await assertion(asked)) });
}

async function addPhone(form) {
  const name = form.elements.name.value.trim();
  const made = await registration(await post("/login/new", {}), name);
  return post(form.dataset.register, { ...made, code: form.elements.code.value.trim() });
}

function explain(error) {
  if (error instanceof Refused) return error.message;
  switch (error.name) {
    case "NotAllowedError": return "It was not confirmed, so nothing was done. Try it again.";
    case "InvalidStateError": return "This phone is set up already. Log in with it.";
    case "NotSupportedError": return "This device cannot keep a passkey of the kind that is needed.";
    case "SecurityError": return "This address cannot have passkeys. Use the one that the console printed.";
    default: return "That did not work. Load the page again.";
  }
}

function showDigits(digits) {
  document.querySelector("[data-digits]").textContent = digits;
  document.querySelector("[data-before]").hidden = true;
  const after = document.querySelector("[data-after]");
  after.hidden = false;
  after.querySelector("h2").focus();
}

async function run(form, action) {
  const problem = form.querySelector("[data-problem]");
  const buttons = [...form.querySelectorAll("button:enabled")]; // what the policy forbids stays so
  problem.hidden = true;
  document.body.dataset.busy = "";
  for (const button of buttons) button.disabled = true;
  try {
    if (!window.PublicKeyCredential) throw new Refused("This browser cannot have passkeys here, which approving needs. Use another browser, or only look.");
    const { next, digits } = await action();
    if (digits) return showDigits(digits);
    const target = new URL(next, location.origin);
    location.assign(target.pathname + target.search); // a path of this console, whatever it says
  } catch (error) {
    problem.textContent = explain(error);
    problem.hidden = false;
    delete document.body.dataset.busy;
    for (const button of buttons) button.disabled = false;
  }
}

function codeFromAddress() {
  const [code, name] = location.hash.slice(1).split("."); // a code is base64url: it has no dot
  if (!code || !document.querySelector("[data-register]")) return;
  history.replaceState(null, "", location.pathname); // before anything else: it is a secret
  for (const input of document.querySelectorAll("[data-register] input[name=code]")) input.value = code;
  const field = document.querySelector("[data-register] input[name=name]");
  try {
    if (name) field.value = decodeURIComponent(name);
  } catch { /* a damaged name: the field keeps its own */ }
  for (const part of document.querySelectorAll("[data-without-code]")) part.hidden = true;
}

document.addEventListener("submit", (event) => {
  const form = event.target;
  const submitter = event.submitter;
  if (form.matches("[data-approve]")) {
    event.preventDefault();
    const fields = new URLSearchParams(new FormData(form, submitter)); // before buttons are disabled
    run(form, () => approve(form, fields));
  } else if (form.matches("[data-passkey]")) {
    event.preventDefault();
    run(form, logIn);
  } else if (form.matches("[data-register]") && !submitter?.matches("[data-look]")) {
    event.preventDefault();
    run(form, () => addPhone(form));
  }
});
codeFromAddress();
window.addEventListener("hashchange", codeFromAddress);
