// Clips as object URLs: fetched before they are shown, dropped when no longer needed.

import { clip } from "./server.js";

const urls = new Map(); // clip id -> promise of an object URL

export function load(id) {
  if (!urls.has(id)) {
    const url = clip(id).then((blob) => URL.createObjectURL(blob));
    url.catch(() => urls.delete(id)); // so that it is tried again
    urls.set(id, url);
  }
  return urls.get(id);
}

export function keepOnly(ids) {
  for (const [id, url] of urls) {
    if (!ids.includes(id)) {
      urls.delete(id);
      url.then(URL.revokeObjectURL, () => {});
    }
  }
}
