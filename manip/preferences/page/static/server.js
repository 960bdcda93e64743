// Requests to the program that serves this page. The token comes from the address.

export class ServerError extends Error {}
export class LockedError extends ServerError {}

function token() {
  const given = location.hash.slice(1);
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("token") ?? "";
}

const authorization = `Bearer ${token()}`;

async function send(path, options = {}) {
  const headers = { Authorization: authorization, ...options.headers };
  let response;
  try {
    response = await fetch(path, { ...options, headers, cache: "no-store" });
  } catch {
    throw new ServerError("No connection to manip label. Is it still running?");
  }
  if (response.status === 401) throw new LockedError("wrong token");
  if (!response.ok) throw new ServerError(await reason(response));
  return response;
}

async function reason(response) {
  try {
    return (await response.json()).error;
  } catch {
    return `manip label answered ${response.status} ${response.statusText}`;
  }
}

async function post(path, body) {
  const options = {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
  };
  return (await send(path, options)).json();
}

export const settings = async () => (await send("/api/settings")).json();
export const view = (labeller) => post("/api/view", { labeller });
export const answer = (body) => post("/api/answer", body);
export const undo = (labeller) => post("/api/undo", { labeller });
export const clip = async (id) => (await send(`/api/clips/${encodeURIComponent(id)}`)).blob();
