//! Accessibility of the page: names, contrast in light and dark, use by keys alone. The checked faults are in
//! `access.js`; with `VOLSEGGS_AXE=FILE`, where FILE is `axe.min.js` of axe-core, its serious ones are checked too.

use crate::browser::{Browser, Tab};
use crate::run;
use crate::socket::Server;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use volseggs_testing::{Need, skip};

/// Unfolds the parts of the panel, so that everything can be checked.
const UNFOLD: &str = "document.querySelectorAll('details').forEach((part) => { part.open = true; })";

/// Returns the script of axe-core, if this machine has it.
fn axe() -> Option<String> {
    let Ok(file) = std::env::var("VOLSEGGS_AXE") else {
        skip(Need::Axe, "VOLSEGGS_AXE, the path of axe-core's axe.min.js, is not set, so its checks are skipped");
        return None;
    };
    Some(std::fs::read_to_string(&file).unwrap_or_else(|e| panic!("VOLSEGGS_AXE={file}: {e}")))
}

/// Returns the faults of the page in its present state.
fn faults(browser: &mut Browser, tab: &Tab, axe: Option<&str>) -> Vec<Value> {
    let mut found = browser.eval(tab, include_str!("access.js")).as_array().unwrap().clone();
    if let Some(axe) = axe {
        browser.eval(tab, &format!("(() => {{ {axe}; return 0; }})()"));
        let serious = "axe.run().then((r) => r.violations.filter((v) => /serious|critical/.test(v.impact))\
                       .map((v) => `${v.id}: ${v.nodes.map((n) => n.html).join(' ')}`))";
        found.extend(browser.eval(tab, serious).as_array().unwrap().clone());
    }
    found
}

#[test]
fn the_page_is_accessible_in_light_and_dark() {
    let Some(mut browser) = Browser::start() else { return };
    let axe = axe();
    let axe = axe.as_deref();
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let tab = browser.visit(&server);
    for scheme in ["light", "dark"] {
        let media = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
        browser.call(Some(&tab), "Emulation.setEmulatedMedia", media);
        assert_eq!(faults(&mut browser, &tab, axe), [] as [Value; 0], "{scheme}, at the start");
        browser.eval(&tab, UNFOLD);
        assert_eq!(faults(&mut browser, &tab, axe), [] as [Value; 0], "{scheme}, unfolded");
        // as much as possible on the page: handles, an opened row, an edit, an error message
        browser.eval(&tab, "document.querySelector('#tree input[type=checkbox]').click()");
        browser.eval(&tab, "document.querySelector('#tree [data-key^=more]').click()");
        browser.eval(&tab, "document.getElementById('hide').click()");
        browser.wait(&tab, "document.querySelectorAll('#edits li').length > 0");
        browser.set(&tab, "name", "");
        browser.eval(&tab, "document.getElementById('commit').requestSubmit()");
        browser.wait(&tab, "document.getElementById('message').classList.contains('wrong')");
        browser.wait(&tab, "!document.getElementById('gizmo').hasAttribute('hidden')");
        browser.rests(&tab);
        browser.shoot(&tab, &format!("6-{scheme}"));
        assert_eq!(faults(&mut browser, &tab, axe), [] as [Value; 0], "{scheme}, with everything shown");
        browser.eval(&tab, "document.getElementById('picture').focus()");
        browser.key(&tab, "?", 8);
        browser.wait(&tab, "document.getElementById('help').open");
        browser.shoot(&tab, &format!("7-help-{scheme}"));
        assert_eq!(faults(&mut browser, &tab, axe), [] as [Value; 0], "{scheme}, with help");
        browser.key(&tab, "Escape", 0);
        browser.wait(&tab, "!document.getElementById('help').open");
        browser.eval(&tab, "document.querySelector('#tree input[type=checkbox]').click()");
        browser.eval(&tab, "document.querySelector('#tree [data-key^=more]').click()");
    }
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
}

#[test]
fn every_control_is_reachable_by_keys_and_shows_its_focus() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let tab = browser.visit(&server);
    browser.eval(&tab, "document.querySelector('#tree input[type=checkbox]').click()");
    browser.wait(&tab, "!document.getElementById('gizmo').hasAttribute('hidden')");
    browser.rests(&tab);
    browser.eval(&tab, UNFOLD);
    let wanted = "[...document.querySelectorAll('button, input, select, summary, canvas, [tabindex]')]\
                  .filter((e) => !e.disabled && e.tabIndex >= 0 && e.checkVisibility() && !e.closest('dialog'))";
    browser.eval(&tab, &format!("{wanted}.forEach((e, k) => {{ e.dataset.nth = k; }})"));
    let count = browser.eval(&tab, &format!("{wanted}.length")).as_u64().unwrap();
    assert!(count > 40, "{count} controls");
    browser.eval(&tab, "document.activeElement.blur()");
    let mut reached = BTreeSet::new();
    for _ in 0..count + 6 {
        browser.key(&tab, "Tab", 0);
        let at = browser.eval(
            &tab,
            "(() => { const e = document.activeElement; if (e === document.body) return null; \
             const own = getComputedStyle(e), mark = e.querySelector?.('.mark'); \
             const shown = own.outlineStyle !== 'none' && parseFloat(own.outlineWidth) > 0 \
               || mark && getComputedStyle(mark).stroke === 'rgb(255, 210, 63)'; \
             return { nth: Number(e.dataset.nth), what: e.outerHTML.slice(0, 120), shown: Boolean(shown) && e.matches(':focus-visible') }; })()",
        );
        // past the last control the focus leaves the page; when it comes back, the window may not be the active one
        // yet, and then nothing shows its focus
        if at.is_null() {
            break;
        }
        assert_eq!(at["shown"], true, "no ring around {}", at["what"]);
        // a list that scrolls may be reached too
        reached.extend(at["nth"].as_u64());
    }
    let missed: Vec<u64> = (0..count).filter(|k| !reached.contains(k)).collect();
    let what = browser.eval(
        &tab,
        &format!("{missed:?}.map((k) => document.querySelector(`[data-nth='${{k}}']`)?.outerHTML.slice(0, 90))"),
    );
    assert!(missed.is_empty(), "Tab does not reach {what}");
    browser.call(Some(&tab), "Page.bringToFront", json!({}));
    browser.wait(&tab, "document.hasFocus()");

    // a part is folded by keys, and stays folded when the page is reloaded
    browser.eval(&tab, "document.querySelector('#part-look summary').focus()");
    browser.key(&tab, "Enter", 0);
    browser.wait(&tab, "!document.getElementById('part-look').open");
    browser.wait(&tab, "JSON.parse(sessionStorage.getItem('parts'))['part-look'] === false");
    let address = server.url();
    browser.call(Some(&tab), "Page.navigate", json!({ "url": address }));
    browser.wait(&tab, "document.getElementById('run').textContent !== 'volseggs'");
    browser.rests(&tab);
    assert_eq!(
        browser.eval(&tab, "[document.getElementById('part-look').open, document.getElementById('part-edits').open]"),
        json!([false, true])
    );

    // Space acts on what has the focus
    browser.eval(&tab, "document.getElementById('loop').focus()");
    browser.key(&tab, " ", 0);
    assert_eq!(
        browser.eval(&tab, "[document.getElementById('loop').checked, document.getElementById('play').ariaLabel]"),
        json!([false, "Play"])
    );

    // the picture itself, by keys
    browser.eval(&tab, "document.getElementById('picture').focus()");
    let mut before = browser.picture(&tab);
    for key in ["ArrowLeft", "ArrowUp", "+", "-", "q", ".", "r"] {
        let asked = browser.eval(&tab, "document.getElementById('picture').dataset.frame");
        browser.key(&tab, key, 0);
        browser.wait(&tab, &format!("document.getElementById('picture').dataset.frame !== {asked}"));
        browser.rests(&tab);
        let after = browser.picture(&tab);
        assert_ne!(after, before, "{key} does nothing");
        before = after;
    }
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
}
